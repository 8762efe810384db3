"""One cell drawn from a scenario: what is true in it, and what the estimator may know of it."""

import dataclasses
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.machine_errors import own_pose
from omm_core.planning.pattern import Stop, paired_stops
from omm_core.session.quantities import THETA
from omm_simulation.machine_errors import (
    DrawnErrors,
    draw_errors,
    draw_true_calibration,
    draw_true_part,
)
from omm_simulation.scenario import Scenario

# What is drawn from one seed must not depend on what else is drawn from it.
_NAMES = (
    "part", "clamping", "stops", "machine", "scene",
    "errors", "targets", "calibration", "seat",
)  # fmt: skip
# Far from the seeds of clampings that people number on.
_NEXT_REPEAT = 1_000_003
_STREAMS = {name: i for i, name in enumerate(_NAMES)}


def random_stream(seed: int, name: str) -> np.random.Generator:
    """Return a separate source of random numbers for each thing that is drawn in a cell."""
    return np.random.default_rng([seed, _STREAMS[name]])


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """A cell with everything that is true in it.

    Attributes
    ----------
    scenario : Scenario
    seed : int
    machine_T_part : RigidTransform
    gamma_s_rad : float
        How far the holder is turned in the spindle.
    true_part : Part
        Where the targets really are.
    true_calibration : CameraCalibration
        The camera as it really is, in the holder as it seats in this clamping.
    bumped_id : int or None
    stops : tuple of Stop
        In the order of the program.
    errors : DrawnErrors
        Of the machine.
    clamping_seed : int
        What is anew with each clamping is drawn from it: stops, images.
    """

    scenario: Scenario
    seed: int
    machine_T_part: RigidTransform
    gamma_s_rad: float
    true_part: Part
    true_calibration: CameraCalibration
    bumped_id: int | None
    stops: tuple[Stop, ...]
    errors: DrawnErrors
    clamping_seed: int

    def theta(self) -> dict[str, float]:
        """Return the true absolute pose, in the form of `solve --json` and in the order of θ."""
        return self._theta(self.machine_T_part)

    def theta_own(self) -> dict[str, float]:
        """Return the true pose in the machine's own coordinates, in the same form."""
        if self.errors.geometry is None:
            return self.theta()
        ids = [target.id for target in self.scenario.part.targets]
        own = own_pose(
            self.machine_T_part,
            [target.xyz_mm for target in self.scenario.part.targets],
            [ids.index(stop.target_id) for stop in self.stops],
            self.geometry_at_stops_mm(),
        )
        return self._theta(own)

    def geometry_at_stops_mm(self) -> NDArray[np.float64]:
        """Return the machine's geometric errors at the programmed stops, (S, 3)."""
        return self.errors.geometry_mm(
            np.array([stop.spindle_in_machine_mm for stop in self.stops])
        )

    def _theta(self, machine_T_part: RigidTransform) -> dict[str, float]:
        values = (
            *machine_T_part.euler_xyz_rad(), *machine_T_part.translation_mm, self.gamma_s_rad
        )  # fmt: skip
        return {quantity.key: float(value) for quantity, value in zip(THETA, values)}

    def truth(self) -> dict[str, Any]:
        """Return what truth.json says: the poses, and everything that is not as it seems."""
        told, true = self.scenario.calibration, self.true_calibration
        names = told.parameter_names()
        return {
            "scenario": self.scenario.name,
            "seed": self.seed,
            "theta": self.theta(),
            "theta_own": self.theta_own(),
            "bumped_id": self.bumped_id,
            "machine": {
                **dataclasses.asdict(self.scenario.errors),
                "geometry_at_stops_mm": self.geometry_at_stops_mm().tolist(),
            },
            "part_warmth_K": self.errors.part_warmth_K,
            "targets": [{"id": t.id, "xyz_mm": t.xyz_mm.tolist()} for t in self.true_part.targets],
            "calibration": dict(zip(names, true.parameter_values(names).tolist())),
        }


def draw(
    scenario: Scenario,
    seed: int,
    *,
    clamping_seed: int | None = None,
    repeat: int = 1,
    bumped_id: int | None = None,
    bump_mm: tuple[float, float, float] = (0.3, -0.2, 0.0),
) -> Cell:
    """Draw a cell.

    Parameters
    ----------
    scenario : Scenario
    seed : int
        Equal seeds make equal cells.
    clamping_seed : int, optional
        Draws what is anew with each clamping: the same machine and part, the camera clamped anew
        and everything measured once more (repeatability).
    repeat : int
        Number of the measurement in that clamping: the holder stays as it is, stops and images
        are anew.
    bumped_id : int, optional
        A target that is not where the part file says.
    bump_mm : tuple
        By how much, in the part frame.
    """
    rng = random_stream(seed, "part")
    placement = scenario.placement
    translation, angles = (
        np.array(middle) + rng.uniform(-1.0, 1.0, 3) * spread
        for middle, spread in (
            (placement.translation_mm, placement.translation_range_mm),
            (placement.euler_xyz_rad, placement.euler_xyz_range_rad),
        )
    )
    alpha, beta, gamma = angles
    clamping_seed = seed if clamping_seed is None else clamping_seed
    clamping = random_stream(clamping_seed, "clamping")
    errors = draw_errors(scenario.errors, random_stream(seed, "errors"))
    true_part = draw_true_part(
        scenario.part, scenario.errors, errors, random_stream(seed, "targets")
    )
    return Cell(
        scenario=scenario,
        seed=seed,
        machine_T_part=RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, translation),
        gamma_s_rad=float(clamping.uniform(-0.5, 0.5) * scenario.backlash_rad),
        true_part=_bumped(true_part, bumped_id, bump_mm),
        true_calibration=draw_true_calibration(
            scenario.calibration,
            scenario.errors,
            random_stream(seed, "calibration"),
            random_stream(clamping_seed, "seat"),
        ),
        bumped_id=bumped_id,
        stops=_stops(scenario, seed),
        errors=errors,
        clamping_seed=clamping_seed + _NEXT_REPEAT * (repeat - 1),
    )


def write_estimator_files(cell: Cell, folder: Path) -> tuple[Path, Path]:
    """Write part.yaml and camera.yaml, all that the estimator gets; returns the two paths."""
    folder.mkdir(parents=True, exist_ok=True)
    part, camera = folder / "part.yaml", folder / "camera.yaml"
    shutil.copyfile(cell.scenario.part_file, part)
    shutil.copyfile(cell.scenario.calibration_file, camera)
    return part, camera


def add_wishes(part_file: Path, cell: Cell) -> None:
    """Add to a part file how the part is wanted: level, within 0.2 mm/m; and three jacks."""
    z = cell.scenario.placement.translation_mm[2]
    points = np.array([target.xyz_mm for target in cell.scenario.part.targets])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low[0] + high[0]) / 2.0
    feet = ((low[0], low[1]), (high[0], low[1]), (middle, high[1]))
    wishes = {
        "nominal": {"translation_mm": [None, None, float(z)], "euler_xyz_rad": [0.0, 0.0, None]},
        "tolerances": {"alpha_rad": 2.0e-4, "beta_rad": 2.0e-4, "z_mm": 0.2},
        "jacks": [
            {"name": f"J{k}", "xyz_mm": [float(a), float(b), 0.0], "travel_mm": [-20.0, 20.0]}
            for k, (a, b) in enumerate(feet, start=1)
        ],
    }
    told = part_file.read_text(encoding="utf-8")
    part_file.write_text(told + yaml.safe_dump(wishes, sort_keys=False), encoding="utf-8")


def write_truth(cell: Cell, path: Path) -> None:
    """Write truth.json, which the estimator does not get."""
    path.write_text(json.dumps(cell.truth(), indent=1) + "\n", encoding="utf-8")


def _bumped(part: Part, target_id: int | None, bump_mm: tuple[float, float, float]) -> Part:
    if target_id is None:
        return part
    if part.target(target_id) is None:
        known = ", ".join(str(target.id) for target in part.targets)
        raise InputError(f"Expected one of the targets to bump: {known}, got {target_id}.")
    return dataclasses.replace(
        part,
        targets=tuple(
            dataclasses.replace(t, xyz_mm=t.xyz_mm + bump_mm) if t.id == target_id else t
            for t in part.targets
        ),
    )


def _stops(scenario: Scenario, seed: int) -> tuple[Stop, ...]:
    """Return two stops for each target, one stereo base apart along the spindle's x.

    The programmer knows the part's nominal place and the camera's nominal holder, not the truth.
    """
    program, placement = scenario.program, scenario.placement
    rng = random_stream(seed, "stops")
    machine_T_part = RigidTransform.from_euler_xyz_rad(
        *placement.euler_xyz_rad, translation_mm=placement.translation_mm
    )
    machine_R_spindle = RigidTransform.from_euler_xyz_rad(
        *scenario.machine.spindle_euler_xyz_rad
    ).rotation
    inwards = _towards_the_middle(scenario.part, machine_T_part, machine_R_spindle[:, 2])
    stops = []
    for stop in paired_stops(
        scenario.part,
        scenario.calibration,
        machine_T_part,
        machine_R_spindle,
        distance_mm=program.distance_mm,
        stereo_base_mm=program.stereo_base_mm,
        offset_mm=program.offset_mm,
    ):
        spread = rng.uniform(-1.0, 1.0, 3) * program.spread_mm
        inward = program.inward_mm * inwards[stop.target_id]
        place = np.round(stop.spindle_in_machine_mm + inward + spread, 3)
        stops.append(Stop(target_id=stop.target_id, spindle_in_machine_mm=place))
    _check_reachable(scenario, stops)
    return tuple(stops)


def _towards_the_middle(
    part: Part, machine_T_part: RigidTransform, axis: NDArray[np.float64]
) -> dict[int, NDArray[np.float64]]:
    """Return each target's direction to the middle of all, (3,), across the spindle's axis."""
    places = machine_T_part @ np.array([target.xyz_mm for target in part.targets])
    across = (places.mean(axis=0) - places) @ (np.eye(3) - np.outer(axis, axis))
    lengths = np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return dict(zip((target.id for target in part.targets), across / lengths))


def _check_reachable(scenario: Scenario, stops: list[Stop]) -> None:
    for axis, name in enumerate("XYZ"):
        limits = scenario.machine.axes[name]
        for stop in stops:
            position = stop.spindle_in_machine_mm[axis]
            if not limits.minimum_mm <= position <= limits.maximum_mm:
                raise InputError(
                    f"Scenario {scenario.name}: expected {name} within {limits.minimum_mm} and "
                    f"{limits.maximum_mm} mm, got {position} for target {stop.target_id}: change "
                    "the part's placement, the program's distance or the axis' limits."
                )
