"""Adjust a camera to a plate of coded targets at rest, seen from many places of the spindle.

Unknowns: the camera (13), the plate's pose (6), the targets' coordinates (observed with their
sigma) and where the spindle really stood (observed with that of a stop). γ_s is 0 by definition.
A height of the camera is the same as a height of the plate; only a touched target tells them apart.
What the set leaves open is found by the algebra (openness.py); lengths of the camera's place that
are open are assumed, and named, and everything else is solved. With more open, nothing is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Problem, Solution, solve
from omm_core.camera_calibration.assumed import (
    PLACE,
    assumed_sigmas,
    carried_along,
    coarse_touch,
    opened_by,
    placed,
    without_coarse_touch,
)
from omm_core.camera_calibration.further_terms import further_terms, words_of_missed
from omm_core.camera_calibration.machine_run import PlateRun, plate_problem, plate_run
from omm_core.camera_calibration.machine_start import spindle_tilts, start_from_run
from omm_core.camera_calibration.model import PARAMETERS, Sensor
from omm_core.camera_calibration.moving import moved_while_taken
from omm_core.camera_calibration.openness import sizes
from omm_core.camera_calibration.patterns import residual_patterns, words_of_patterns
from omm_core.camera_calibration.result import (
    CalibrationResult,
    DotObservation,
    require_determined,
)
from omm_core.camera_calibration.weeding import Weeded, robust_inflation, weed
from omm_core.errors import MeasurementError
from omm_core.files.calibration_set import Touched
from omm_core.files.part import Part
from omm_core.geometry import rotation_from_euler_xyz_rad
from omm_core.part_pose import Observation as Seen

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# What the camera is held to its start within, until it is known what is open: sizes, and mm.
_LOOSE, _LOOSE_PLACE_MM = 10.0, (100.0, 100.0, 1000.0)
_ROBUST_ROUNDS = 8
# A dot farther than this from where the robust start has it is not used to begin with.
_ASTRAY_PX = 10.0


def calibrate_by_run(
    sensor: Sensor,
    seen: Sequence[Seen],
    part: Part,
    *,
    machine_sigma_mm: float,
    touched: Touched | None = None,
    hint: Array | None = None,
) -> CalibrationResult:
    """Calibrate.

    Parameters
    ----------
    sensor : Sensor
    seen : sequence of Observation
        Targets in images, with the spindle's poses.
    part : Part
        The plate, nominally.
    machine_sigma_mm : float
        Of each axis at each stop.
    touched : Touched, optional
        A probed height.
    hint : (13,) array, optional
        A camera that may be near.

    Raises
    ------
    InputError
        If the touched target is not of the plate.
    MeasurementError
        If the set leaves more open than the camera's place, or no camera fits.
    """
    run = plate_run(sensor, seen, part, machine_sigma_mm, touched)
    camera, plate = start_from_run(sensor, run.seen, part, hint)
    values, used = _near({"camera": camera[None], "plate": plate[None]}, run)
    information, opened = opened_by(without_coarse_touch(run), used, values)
    assumed = assumed_sigmas(opened, run, hinted=hint is not None)
    values = placed(run, values, tuple(assumed), hint)
    adjusted = without_coarse_touch(run) if "z_mm" in assumed else run
    least = len(PARAMETERS)

    def adjust(used: Mask) -> tuple[Problem, Solution]:
        problem = plate_problem(adjusted, used, values, held=tuple(assumed))
        return problem, solve(problem)

    weeded = weed(adjust, run.stop_of, used, least=least, refuse_moved=partial(_refuse_moved, run))
    _refuse_tail(run, weeded)
    solution, used = weeded.solution, weeded.used
    require_determined(sensor, solution)
    result = _result(run, weeded, assumed)
    carried = carried_along(information, tuple(assumed))
    assumption = carried @ np.diag([sigma**2 for sigma in assumed.values()]) @ carried.T
    return replace(result, covariance=result.covariance + assumption)


def _near(values: dict[str, Array], run: PlateRun) -> tuple[dict[str, Array], Mask]:
    """Return a camera and a plate that fit about, whatever the set leaves open, and what fits."""
    loose = _LOOSE * sizes(run.sensor, float(values["camera"][0, 0]))
    loose[PLACE] = _LOOSE_PLACE_MM
    used = np.ones(len(run.pixels), dtype=bool)
    inflation = np.ones(len(run.pixels))
    held = () if spindle_tilts(run.rotations) else ("z_mm",)
    for _ in range(_ROBUST_ROUNDS):
        problem = plate_problem(run, used, values, held=held, loose=loose, coarse=inflation)
        solution = solve(problem, iterations=30)
        values = {name: solution.values[name] for name in ("camera", "plate")}
        away = np.linalg.norm(solution.residuals["pixels"], axis=1)
        if away.max() < _ASTRAY_PX:
            break
        inflation = robust_inflation(solution.residuals["pixels"])
    near = away < max(_ASTRAY_PX, 5 * float(np.median(away)))
    used = near if near.mean() >= 0.8 else used
    found = solve(plate_problem(run, used, values, loose=loose), iterations=30).values
    return {name: found[name] for name in ("camera", "plate")}, used


def _result(run: PlateRun, weeded: Weeded, assumed: dict[str, float]) -> CalibrationResult:
    solution = weeded.solution
    camera = solution.values["camera"][0].copy()
    factor = max(solution.sigma0, 1.0) ** 2
    covariance = solution.covariance_of("camera") * factor
    stops = solution.values["stops"]
    rotation = rotation_from_euler_xyz_rad(*solution.values["plate"][0, :3])
    centres = solution.values["targets"] @ rotation.T + solution.values["plate"][0, 3:]
    from_stop = centres[run.target_of] - (run.places + stops)[run.stop_of]
    in_taper = np.einsum("nij,ni->nj", run.rotations[run.stop_of], from_stop)
    depth = (in_taper - camera[7:10]) @ rotation_from_euler_xyz_rad(*camera[10:])[:, 2]
    result = CalibrationResult(
        sensor=run.sensor,
        camera=camera,
        covariance=covariance,
        sigma0=solution.sigma0,
        degrees_of_freedom=solution.degrees_of_freedom,
        converged=solution.converged,
        observations=tuple(
            DotObservation(
                image=str(o.stamp_ns),
                target_id=o.target_id,
                pixel=run.pixels[i],
                residual_px=-solution.residuals["pixels"][i],
                reason=weeded.reasons[i],
            )
            for i, o in enumerate(run.seen)
        ),
        images=len(run.places),
        covered_mm=(float(depth.min()), float(depth.max())),
        dots_mm=in_taper,
        undetermined=tuple(
            name
            for name in PARAMETERS
            if name in assumed and not (name == "z_mm" and coarse_touch(run) is not None)
        ),
    )
    block = next(b for b in weeded.problem.blocks if b.name == "pixels")
    terms = further_terms(run.sensor, camera, block, solution)
    turns = np.arctan2(run.rotations[:, 1, 0], run.rotations[:, 0, 0])
    heights = np.round(run.places[:, 2], -1)
    groupings: dict[str, Array] = {
        "turn": np.asarray(np.round(np.degrees(turns)), dtype=float)[run.stop_of],
        "height": heights[run.stop_of],
    }
    patterns = residual_patterns(run.sensor, camera, block, solution, groupings)
    return replace(
        result,
        findings=(
            *_findings(run, weeded, assumed),
            *words_of_missed(terms),
            *words_of_patterns(patterns),
        ),
        extra={
            "further_terms": [t.to_json_dict() for t in terms],
            "patterns": [p.to_json_dict() for p in patterns],
        },
    )


def _refuse_moved(run: PlateRun, problem: Problem, solution: Solution) -> None:
    """Raise MeasurementError where the plate stood elsewhere from some image on."""
    block = next(b for b in problem.blocks if b.name == "pixels")
    by_plate = solution.derivatives["pixels"]["plate"]
    moved = moved_while_taken(block, solution, by_plate, run.stop_of)
    if moved is None:
        return
    turn, shift = np.linalg.norm(moved.step[:3]), np.linalg.norm(moved.step[3:])
    raise MeasurementError(
        f"The plate moved between {_between(run, moved.first)}, by about {shift:.3f} mm and"
        f" {1000 * turn:.2f} mrad, or the camera in its holder. Clamp both, and take the set again."
    )


def _refuse_tail(run: PlateRun, weeded: Weeded) -> None:
    """Raise MeasurementError where all from some image on, or all before it, does not fit."""
    out, count = weeded.whole_images, len(run.places)
    if len(out) > 1 and out in (tuple(range(len(out))), tuple(range(count - len(out), count))):
        first = len(out) if out[0] == 0 else out[0]
        raise MeasurementError(
            f"The plate moved between {_between(run, first)}, or the camera in its holder: the"
            " images before and after it contradict each other. Clamp both, and take the set again."
        )


def _between(run: PlateRun, first: int) -> str:
    stamps = sorted({o.stamp_ns for o in run.seen})
    return (
        f"image {stamps[first - 1]} and image {stamps[first]} (number {first} and {first + 1} of"
        f" {len(stamps)})"
    )


def _findings(run: PlateRun, weeded: Weeded, assumed: dict[str, float]) -> tuple[str, ...]:
    solution, used = weeded.solution, weeded.used
    stamps = sorted({o.stamp_ns for o in run.seen})
    found = [
        f"image {stamps[i]} is not of the set (all of it contradicts the others): left out"
        for i in weeded.whole_images
    ]
    for name, sigma in assumed.items():
        value = solution.values["camera"][0, PARAMETERS.index(name)]
        if name == "z_mm" and coarse_touch(run) is not None:
            found.append(
                f"z_mm is known as the touch is: {value:.1f} mm, sigma {sigma:g} mm; touch the"
                " target more finely"
            )
            continue
        words = (
            f"{name} is undetermined by this set; assumed {value:.1f} within {sigma:g} mm (sigma)"
        )
        why = "take images with the spindle turned (C) as well"
        if name == "z_mm" and run.touched is not None:
            why = "the touch gives a height (machine Z), which lies across this spindle's axis"
        elif name == "z_mm":
            why = "touch a target of the plate and add 'touched' to the set"
        found.append(f"{words}: {why}")
    single = ~used & ~np.isin(run.stop_of, weeded.whole_images)
    if single.any():
        dropped = [run.seen[i] for i in np.flatnonzero(single)[:5]]
        names = ", ".join(f"target {o.target_id} in image {o.stamp_ns}" for o in dropped)
        found.append(f"{single.sum()} observations do not fit and are left out: {names}")
    if solution.sigma0 > 1.3:
        found.append(
            f"residuals are {solution.sigma0:.2f} times what was promised; the covariance is"
            " enlarged by that"
        )
    return tuple(found)
