"""What is to be solved: observations, options, and the arrays that the kernels take."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omm_core.errors import InputError
from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.imaging.circle import BOUNDARY_POINTS, CircleCentre, circle_points
from omm_core.part_pose.model import Measured, PixelModel
from omm_core.part_pose.observation import Observation

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

THETA_NAMES = ("alpha_rad", "beta_rad", "gamma_rad", "x_mm", "y_mm", "z_mm", "gamma_s_rad")


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """Observations of one clamping as arrays; the order is (stamp, target), see kernels.py.

    Attributes
    ----------
    observations : tuple of Observation
        In the order of the arrays.
    run_ns : tuple of int
        Stamps of all images of the run, sorted: people count those that show nothing as well.
    points : (T, 1, 3) array
        Target centres relative to X_0, mm.
    circles : (T, 8, 3) array
        Points of their circles relative to X_0; the centre itself where the normal is unknown.
    X0_mm : (3,) array
        Centre of the targets seen, part frame.
    measured : (N, 2) array
    information : (N, 3) array
        Inverse covariances as (col col, col row, row row), 1/px².
    """

    observations: tuple[Observation, ...] = field(repr=False)
    run_ns: tuple[int, ...] = field(repr=False)
    part: Part
    calibration: CameraCalibration
    centre_kind: int
    lens: Array
    R_calib: Array
    d_calib: Array
    stamps_ns: tuple[int, ...]
    R_cnc: Array
    d_cnc: Array
    image_of: Indices
    target_ids: tuple[int, ...]
    target_of: Indices
    points: Array
    circles: Array
    X0_mm: Array
    measured: Array
    information: Array

    def model(self, *, circles: bool = True) -> PixelModel:
        """Return what the kernels predict pixels with."""
        return PixelModel(
            lens=self.lens,
            centre_kind=self.centre_kind,
            R_calib=self.R_calib,
            d_calib=self.d_calib,
            R_cnc=self.R_cnc,
            d_cnc=self.d_cnc,
            image_of=self.image_of,
            target_of=self.target_of,
            points=self.circles if circles else self.points,
        )

    @property
    def seen(self) -> Measured:
        """Centres and weights, as the kernels take them."""
        return Measured(centres=self.measured, information=self.information)

    def without(self, dropped: NDArray[np.bool_]) -> Problem:
        """Return the same problem without some observations (N,)."""
        kept = ~dropped
        return replace(
            self,
            observations=tuple(o for o, keep in zip(self.observations, kept) if keep),
            image_of=self.image_of[kept],
            target_of=self.target_of[kept],
            measured=self.measured[kept],
            information=self.information[kept],
        )

    def with_calibration(self, calibration: CameraCalibration) -> Problem:
        """Return the same problem with another calibration."""
        pose = calibration.taper_T_camera
        return replace(
            self,
            calibration=calibration,
            lens=calibration.lens.kernel_parameters(),
            R_calib=_contiguous(pose.rotation),
            d_calib=_contiguous(pose.translation_mm),
        )

    def __len__(self) -> int:
        """Return the number of observations."""
        return len(self.image_of)


def build_problem(
    observations: Sequence[Observation],
    part: Part,
    calibration: CameraCalibration,
    circle_centre: CircleCentre = CircleCentre.OUTLINE,
    *,
    run_ns: Iterable[int] = (),
) -> Problem:
    """Return the arrays of observations, whatever the order in which these came.

    Raises
    ------
    InputError
        Where an observation is of a target that the part does not have, has a bad number, or
        observations of one image have different poses of the spindle.
    """
    ordered = tuple(sorted(observations, key=lambda o: (o.stamp_ns, o.target_id)))
    target_ids = tuple(sorted({o.target_id for o in ordered}))
    stamps = tuple(sorted({o.stamp_ns for o in ordered}))
    image_of = np.searchsorted(stamps, [o.stamp_ns for o in ordered]).astype(np.int64)
    target_of = np.searchsorted(target_ids, [o.target_id for o in ordered]).astype(np.int64)
    poses: list[RigidTransform | None] = [None] * len(stamps)
    for observation, image in zip(ordered, image_of):
        _check(observation)
        known = poses[image]
        if known is not None and known is not observation.machine_T_spindle:
            _check_same_pose(known, observation)
        poses[image] = observation.machine_T_spindle
    X, circles = _targets(part, target_ids)
    X0 = X.mean(axis=0) if len(X) else np.zeros(3)
    pose = calibration.taper_T_camera
    return Problem(
        observations=ordered,
        run_ns=tuple(sorted({*run_ns, *stamps})),
        part=part,
        calibration=calibration,
        centre_kind=int(circle_centre),
        lens=calibration.lens.kernel_parameters(),
        R_calib=_contiguous(pose.rotation),
        d_calib=_contiguous(pose.translation_mm),
        stamps_ns=stamps,
        R_cnc=_contiguous([p.rotation for p in poses if p is not None]).reshape(-1, 3, 3),
        d_cnc=_contiguous([p.translation_mm for p in poses if p is not None]).reshape(-1, 3),
        image_of=image_of,
        target_ids=target_ids,
        target_of=target_of,
        points=_contiguous((X - X0)[:, None, :]),
        circles=_contiguous(circles - X0),
        X0_mm=X0,
        measured=_contiguous([o.center_px for o in ordered]).reshape(-1, 2),
        information=_information([o.covariance_px2 for o in ordered]),
    )


def _targets(part: Part, target_ids: tuple[int, ...]) -> tuple[Array, Array]:
    """Return centres (T, 3) and circle points (T, 8, 3) of targets, part frame."""
    plane_normal = part.plane_normal()
    centres, circles = (
        np.empty((len(target_ids), 3)),
        np.empty((len(target_ids), BOUNDARY_POINTS, 3)),
    )
    by_id = {target.id: target for target in part.targets}
    for index, target_id in enumerate(target_ids):
        target = by_id.get(target_id)
        if target is None:
            raise InputError(
                f"Expected targets of the part '{part.name}'"
                f" ({', '.join(str(t.id) for t in part.targets)}), got {target_id}."
            )
        centres[index] = target.xyz_mm
        normal = target.normal if target.normal is not None else plane_normal
        # Without a normal there are fewer than three targets, or all on a line: nothing can be
        # solved then, so the direction does not matter.
        circles[index] = circle_points(
            target.xyz_mm, np.array([0.0, 0.0, 1.0]) if normal is None else normal,
            np.asarray(target.dot_diameter_mm),
        )  # fmt: skip
    return centres, circles


def _information(covariances: list[Array]) -> Array:
    c = np.asarray(covariances, dtype=float).reshape(-1, 2, 2)
    determinant = c[:, 0, 0] * c[:, 1, 1] - c[:, 0, 1] ** 2
    parts = np.stack([c[:, 1, 1], -c[:, 0, 1], c[:, 0, 0]], axis=1)
    return np.ascontiguousarray(parts / determinant[:, None])


def _check(observation: Observation) -> None:
    c = np.asarray(observation.covariance_px2, dtype=float)
    center = np.asarray(observation.center_px, dtype=float)
    sound = (
        center.shape == (2,) and c.shape == (2, 2) and np.isfinite(center).all()
        and np.isfinite(c).all() and c[0, 0] > 0 and c[0, 0] * c[1, 1] - c[0, 1] * c[1, 0] > 0
    )  # fmt: skip
    if not sound:
        raise InputError(
            f"Expected a centre (col, row) with a positive definite 2 x 2 covariance for target"
            f" {observation.target_id}, got {center.tolist()} with {c.tolist()}."
        )


def _check_same_pose(known: RigidTransform, observation: Observation) -> None:
    other = observation.machine_T_spindle
    same = np.array_equal(known.rotation, other.rotation) and np.array_equal(
        known.translation_mm, other.translation_mm
    )
    if not same:
        raise InputError(
            "Expected one pose of the spindle for all targets of an image, got several for the"
            f" image of {observation.stamp_ns} ns."
        )


def _contiguous(values: ArrayLike) -> Array:
    return np.ascontiguousarray(values, dtype=float)
