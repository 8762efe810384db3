"""The plan's JSON file, read again by who leads its program."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from omm_core.errors import InputError
from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.machine.kinematics import Kinematics
from omm_core.planning.guide import Guide, GuidedStop
from omm_core.planning.plan import Plan
from omm_core.planning.program import Program
from omm_core.planning.scene import AssumedNoise, Scene

# A guide weighs by its own figures; a plan's noise is not in the file.
_NOISE = AssumedNoise(stop_sigma_mm=0.0, geometry_sigma_mm=0.0, geometry_length_mm=1.0)


def program_json(plan: Plan, program: Program) -> dict[str, Any]:
    """Return the program's images as the plan's file holds them; a look from afar included."""
    stops = list(plan.stops)
    looks = len(program.stops) - len(stops)
    targets = [stops[0].target_ids] * looks + [stop.target_ids for stop in stops]
    return {
        "images": len(program.stops),
        "limit_mm": program.options.limit_mm,
        "stops": [
            {
                "axes": {n: float(v) for n, v in stop.axes.items()},
                "targets": list(ids),
                "look_mm": program.options.limit_mm if stop.look else 0.0,
            }
            for stop, ids in zip(program.stops, targets)
        ],
    }


def guide_from_plan(
    content: Any,
    where: str,
    *,
    part: Part,
    calibration: CameraCalibration,
    kinematics: Kinematics,
) -> Guide:
    """Return the guide of a plan's program.

    Raises
    ------
    InputError
        Where the file is not the plan of this part on this machine, or holds no program.
    """
    try:
        place, program = content["part_taken_at"], content["program"]
        alpha, beta, gamma = (float(v) for v in place["euler_xyz_rad"])
        stops = [_stop(stop, part, kinematics) for stop in program["stops"]]
        scene = Scene(
            part=part,
            calibration=calibration,
            kinematics=kinematics,
            machine_T_part=RigidTransform.from_euler_xyz_rad(
                alpha, beta, gamma, [float(v) for v in place["translation_mm"]]
            ),
            noise=_NOISE,
            play_mm=0.0,
        )
        return Guide(scene=scene, stops=stops, limit_mm=float(program["limit_mm"]))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(
            f"{where}: expected a plan with its program (./omm plan … --out … --json), got"
            f" something else: {error!r}."
        ) from None


def _stop(stop: Mapping[str, Any], part: Part, kinematics: Kinematics) -> GuidedStop:
    rows = {target.id: row for row, target in enumerate(part.targets)}
    unknown = [target for target in stop["targets"] if target not in rows]
    if unknown or not stop["targets"]:
        raise InputError(f"Expected a plan for '{part.name}', got one with target {unknown}.")
    axes = {axis.name: float(stop["axes"][axis.name]) for axis in kinematics.axes}
    return GuidedStop(
        axes=axes,
        rows=tuple(rows[target] for target in stop["targets"]),
        look_mm=float(stop.get("look_mm", 0.0)),
    )
