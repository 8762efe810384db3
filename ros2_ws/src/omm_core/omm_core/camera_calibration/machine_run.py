"""A run over a plate as arrays, and the problem of it that machine.py adjusts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Block, Group, Problem
from omm_core.adjustment.problem import Values
from omm_core.camera_calibration.model import (
    PARAMETERS,
    Sensor,
    project_with_derivatives,
    rotation_derivatives,
)
from omm_core.errors import InputError, MeasurementError
from omm_core.files.calibration_set import Touched
from omm_core.files.part import Part
from omm_core.geometry import rotation_from_euler_xyz_rad
from omm_core.imaging.circle import circle_points
from omm_core.part_pose import Observation as Seen

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


PLATE_NAMES = ("plate alpha", "plate beta", "plate gamma", "plate x", "plate y", "plate z")


@dataclass(frozen=True, kw_only=True, eq=False)
class PlateRun:
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


def plate_run(
    sensor: Sensor,
    seen: Sequence[Seen],
    part: Part,
    machine_sigma_mm: float,
    touched: Touched | None,
) -> PlateRun:
    """Return the arrays of a run.

    Raises
    ------
    InputError
        If the touched target is not of the plate.
    MeasurementError
        If there are too few images.
    """
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
    return PlateRun(
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


def plate_problem(
    run: PlateRun,
    used: Mask,
    values: dict[str, Array],
    *,
    held: tuple[str, ...] = (),
    loose: Array | None = None,
    coarse: Array | None = None,
) -> Problem:
    """Return the problem of camera, plate, targets and stops.

    Parameters
    ----------
    used : (N,) bool array
    values : mapping
        ``camera`` (1, 13) and ``plate`` (1, 6) to start from.
    held : tuple of str
        Parameters of the camera that are kept.
    loose : (13,) array, optional
        Sigma within which the camera is held to its start.
    coarse : (N,) array, optional
        Variances to count the pixels with, px², without the touch: where the start may be wrong,
        or some of the pixels, they bend nothing else.
    """
    zeros = np.zeros(len(run.pixels), dtype=int)
    keep = np.array([[name in held for name in PARAMETERS]])
    prior = None if loose is None else loose[None]
    groups = (
        Group(name="camera", values=values["camera"], held=keep, names=PARAMETERS, sigma=prior),
        Group(name="plate", values=values["plate"], names=PLATE_NAMES),
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
        covariance=run.covariance_px2 if coarse is None else coarse[:, None, None] * np.eye(2),
        index={"camera": zeros, "plate": zeros, "targets": run.target_of, "stops": run.stop_of},
        evaluate=lambda v: _predict(run, v),
        used=used,
    )
    blocks = [pixels]
    if run.touched is not None and coarse is None:
        blocks.append(_touched_block(run, run.touched))
    return Problem(groups=groups, blocks=tuple(blocks))


def _predict(run: PlateRun, values: Values) -> tuple[Array, dict[str, Array]]:
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


def _touched_block(run: PlateRun, touched: Touched) -> Block:
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
