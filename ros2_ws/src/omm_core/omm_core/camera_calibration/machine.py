"""Adjust a camera to a plate of coded targets at rest, seen from many places of the spindle.

Unknowns: the camera (13), the plate's pose (6), the targets' coordinates (observed with their
sigma) and where the spindle really stood (observed with that of a stop). γ_s is 0 by definition.
A height of the camera is the same as a height of the plate; only a touched target tells them apart.
What the set leaves open is found by the adjustment; lengths of the camera's place that are open are
assumed, and named, and everything else is solved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Block, Group, Problem, Solution, solve, test_observations
from omm_core.adjustment.problem import Values
from omm_core.camera_calibration.machine_start import start_from_run
from omm_core.camera_calibration.model import (
    PARAMETERS,
    Sensor,
    project_with_derivatives,
    rotation_derivatives,
)
from omm_core.camera_calibration.result import (
    CalibrationResult,
    Observation,
    require_determined,
)
from omm_core.errors import InputError, MeasurementError
from omm_core.files.calibration_set import Touched
from omm_core.files.part import Part
from omm_core.geometry import rotation_from_euler_xyz_rad
from omm_core.imaging.circle import circle_points
from omm_core.part_pose import Observation as Seen

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LARGEST_T2 = 27.6  # w-test: one in a million of good observations is refused
# What is assumed of a camera's place that a set leaves open: within this of the hint, or of the
# spindle's axis (x, y) and nose (z).
ASSUMED_SIGMA_MM = {"x_mm": 10.0, "y_mm": 10.0, "z_mm": 500.0}
_HINTED_SIGMA_MM = 10.0
# A place known worse than this is open in practice, whatever the rounding says.
_OPEN_MM = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Run:
    """A run as arrays: observations (N), stops (S), targets (T)."""

    seen: tuple[Seen, ...]
    sensor: Sensor
    pixels: Array
    covariance_px2: Array
    stop_of: NDArray[np.int64]
    target_of: NDArray[np.int64]
    target_ids: tuple[int, ...]
    rotations: Array
    places: Array
    xyz: Array
    sigma_xyz: Array
    outlines: Array
    stop_sigma_mm: float
    touched: Touched | None


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
    run = _arrays(sensor, seen, part, machine_sigma_mm, touched)
    camera, plate = start_from_run(sensor, run.seen, part, hint)
    used = np.ones(len(run.pixels), dtype=bool)
    assumed: dict[str, float] = {}
    carried = np.zeros((13, 0))
    values = {"camera": camera[None], "plate": plate[None]}
    values = _adjust(run, used, values, {"z_mm": 1.0}, coarse=True)[1].values
    values = {name: values[name] for name in ("camera", "plate")}
    if hint is not None and touched is None:
        values["plate"][0, 5] -= hint[9] - values["camera"][0, 9]
        values["camera"][0, 9] = hint[9]
    while True:
        problem, solution = _adjust(run, used, values, assumed)
        newly = _open_places(solution) - set(assumed)
        if newly:
            sigmas = ASSUMED_SIGMA_MM if hint is None else dict.fromkeys(newly, _HINTED_SIGMA_MM)
            assumed |= {name: sigmas[name] for name in newly}
            carried = _carried(solution, tuple(assumed))
            continue
        t2 = test_observations(problem, solution)["pixels"].t2
        scale = max(float(np.median(t2[used])) / 1.386, 1.0)
        worst = int(np.argmax(np.where(used, t2, 0.0)))
        if t2[worst] / scale < _LARGEST_T2 or used.sum() < 0.8 * len(used):
            break
        used[worst] = False
    if not assumed:
        require_determined(sensor, solution)
    elif not solution.converged or solution.undetermined:
        raise MeasurementError(
            "The set leaves more open than the camera's place: "
            + "; ".join(", ".join(u.labels[:6]) for u in solution.undetermined)
            + ". Take images at several heights and with the spindle turned."
        )
    result = _result(run, solution, used, assumed)
    assumption = carried @ np.diag([sigma**2 for sigma in assumed.values()]) @ carried.T
    return replace(result, covariance=result.covariance + assumption)


def _arrays(
    sensor: Sensor,
    seen: Sequence[Seen],
    part: Part,
    machine_sigma_mm: float,
    touched: Touched | None,
) -> _Run:
    ordered = tuple(sorted(seen, key=lambda o: (o.stamp_ns, o.target_id)))
    if len({o.stamp_ns for o in ordered}) < 3:
        raise MeasurementError(
            "Expected the plate's targets in at least 3 images with a spindle at rest, got"
            f" {len({o.stamp_ns for o in ordered})}."
        )
    ids = tuple(sorted({o.target_id for o in ordered}))
    if touched is not None and touched.target not in ids:
        raise InputError(
            f"Expected the touched target among those seen ({', '.join(map(str, ids))}), "
            f"got {touched.target}."
        )
    stamps = sorted({o.stamp_ns for o in ordered})
    poses = {o.stamp_ns: o.machine_T_spindle for o in ordered}
    targets = [part.target(i) for i in ids]
    outlines, sigma = [], []
    for target in targets:
        if target is None:
            raise InputError(f"Expected observations of the plate's targets only ({part.name}).")
        normal = part.normal_of(target)
        diameter = target.dot_diameter_mm if normal is not None else 1e-6
        facing = np.array([0.0, 0.0, 1.0]) if normal is None else normal
        outlines.append(circle_points(np.zeros((1, 3)), facing[None], np.array([diameter]))[0])
        known = target.sigma_xyz_mm
        sigma.append(np.full(3, 1e-6) if known is None else np.maximum(known, 1e-6))
    return _Run(
        seen=ordered,
        sensor=sensor,
        pixels=np.array([o.center_px for o in ordered], dtype=float),
        covariance_px2=np.array([o.covariance_px2 for o in ordered], dtype=float),
        stop_of=np.array([stamps.index(o.stamp_ns) for o in ordered]),
        target_of=np.array([ids.index(o.target_id) for o in ordered]),
        target_ids=ids,
        rotations=np.array([poses[s].rotation for s in stamps]),
        places=np.array([poses[s].translation_mm for s in stamps]),
        xyz=np.array([t.xyz_mm for t in targets if t is not None]),
        sigma_xyz=np.array(sigma),
        outlines=np.array(outlines),
        stop_sigma_mm=machine_sigma_mm,
        touched=touched,
    )


def _adjust(
    run: _Run,
    used: Mask,
    values: dict[str, Array],
    assumed: dict[str, float],
    *,
    coarse: bool = False,
) -> tuple[Problem, Solution]:
    """Adjust; coarse: pixels count little, so that what the start gets wrong bends nothing else."""
    held = np.array([[name in assumed for name in PARAMETERS]])
    n, zeros = len(run.pixels), np.zeros(len(run.pixels), dtype=int)
    groups = (
        Group(name="camera", values=values["camera"], held=held, names=PARAMETERS),
        Group(name="plate", values=values["plate"]),
        Group(name="targets", values=run.xyz, sigma=run.sigma_xyz),
        Group(
            name="stops",
            values=np.zeros_like(run.places),
            sigma=np.full_like(run.places, run.stop_sigma_mm),
        ),
    )
    pixels = Block(
        name="pixels",
        observed=run.pixels,
        covariance=np.tile(np.eye(2), (n, 1, 1)) if coarse else run.covariance_px2,
        index={"camera": zeros, "plate": zeros, "targets": run.target_of, "stops": run.stop_of},
        evaluate=lambda v: _predict(run, v),
        used=used,
    )
    blocks = [pixels]
    if run.touched is not None and not coarse:
        blocks.append(_touched_block(run, run.touched))
    problem = Problem(groups=groups, blocks=tuple(blocks))
    return problem, solve(problem)


def _predict(run: _Run, values: Values) -> tuple[Array, dict[str, Array]]:
    plate, targets, stops = values["plate"][0], values["targets"], values["stops"]
    rotation = rotation_from_euler_xyz_rad(*plate[:3])
    in_part = targets[run.target_of][:, None] + run.outlines[run.target_of]
    from_stop = in_part @ rotation.T + plate[3:] - (run.places + stops)[run.stop_of][:, None]
    spindle_R = run.rotations[run.stop_of]
    centres, by_camera, by_outline = project_with_derivatives(
        run.sensor, values["camera"][0], from_stop @ spindle_R
    )
    by_machine = by_outline @ np.swapaxes(spindle_R, 1, 2)[:, None]
    whole = by_machine.sum(axis=1)
    turned = np.stack([in_part @ d.T for d in rotation_derivatives(plate[:3])], axis=-1)
    by_angles = np.einsum("nkij,nkja->nia", by_machine, turned)
    return centres, {
        "camera": by_camera,
        "plate": np.concatenate([by_angles, whole], axis=2),
        "targets": whole @ rotation,
        "stops": -whole,
    }


def _touched_block(run: _Run, touched: Touched) -> Block:
    which = run.target_ids.index(touched.target)

    def evaluate(values: Values) -> tuple[Array, dict[str, Array]]:
        plate, xyz = values["plate"][0], values["targets"][which]
        row = rotation_from_euler_xyz_rad(*plate[:3])[2]
        angles = [d[2] @ xyz for d in rotation_derivatives(plate[:3])]
        by_plate = np.array([[[*angles, 0.0, 0.0, 1.0]]])
        return np.array([[row @ xyz + plate[5]]]), {"plate": by_plate, "targets": row[None, None]}

    return Block(
        name="touched",
        observed=np.array([[touched.z_mm]]),
        covariance=np.array([[[touched.sigma_mm**2]]]),
        index={"plate": np.array([0]), "targets": np.array([which])},
        evaluate=evaluate,
    )


def _open_places(solution: Solution) -> set[str]:
    """Return which lengths of the camera's place are open, exactly or in practice."""
    found = {name for u in solution.undetermined for name in u.labels if name in ASSUMED_SIGMA_MM}
    sigma = np.sqrt(np.diag(solution.covariance_of("camera")))
    return found | {n for n in ASSUMED_SIGMA_MM if sigma[PARAMETERS.index(n)] > _OPEN_MM}


def _carried(solution: Solution, names: tuple[str, ...]) -> Array:
    """Return how the camera moves with what is assumed, (13, A): rows of ``names`` are unit."""
    covariance = solution.covariance_of("camera")
    at = [PARAMETERS.index(name) for name in names]
    part = solution.slices["camera"]
    for open_direction in solution.undetermined:
        along = open_direction.direction[part]
        along = along / max(float(np.abs(along[at]).max()), 1e-12)
        covariance = covariance + 1e8 * np.outer(along, along)
    return np.asarray(covariance[:, at] @ np.linalg.pinv(covariance[np.ix_(at, at)]))


def _result(
    run: _Run, solution: Solution, used: Mask, assumed: dict[str, float]
) -> CalibrationResult:
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
            Observation(
                image=str(o.stamp_ns),
                target_id=o.target_id,
                pixel=run.pixels[i],
                residual_px=-solution.residuals["pixels"][i],
                reason=None if used[i] else "does not fit the others (w-test)",
            )
            for i, o in enumerate(run.seen)
        ),
        images=len(run.places),
        covered_mm=(float(depth.min()), float(depth.max())),
        undetermined=tuple(name for name in PARAMETERS if name in assumed),
    )
    return replace(result, findings=_findings(run, solution, used, assumed))


def _findings(
    run: _Run, solution: Solution, used: Mask, assumed: dict[str, float]
) -> tuple[str, ...]:
    found = []
    for name, sigma in assumed.items():
        value = solution.values["camera"][0, PARAMETERS.index(name)]
        words = (
            f"{name} is undetermined by this set; assumed {value:.1f} within {sigma:g} mm (sigma)"
        )
        why = (
            "touch a target of the plate and add 'touched' to the set"
            if name == "z_mm"
            else "take images with the spindle turned (C) as well"
        )
        found.append(f"{words}: {why}")
    if not used.all():
        dropped = [run.seen[i] for i in np.flatnonzero(~used)[:5]]
        names = ", ".join(f"target {o.target_id} in image {o.stamp_ns}" for o in dropped)
        found.append(f"{(~used).sum()} observations do not fit and are left out: {names}")
    if solution.sigma0 > 1.3:
        found.append(
            f"residuals are {solution.sigma0:.2f} times what was promised; the covariance is"
            " enlarged by that"
        )
    return tuple(found)
