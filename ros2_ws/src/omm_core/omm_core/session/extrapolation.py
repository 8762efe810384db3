"""Say where a measurement uses its calibration outside what the calibration's set covered."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Part
from omm_core.geometry import RigidTransform, holder_rotation
from omm_core.imaging.calibration import CameraCalibration
from omm_core.part_pose import Solution
from omm_core.words import Words, keyed

Array = NDArray[np.float64]

_SLACK = 0.05  # of a distance, and of the image's size


def extrapolation_words(
    solution: Solution, part: Part, calibration: CameraCalibration
) -> tuple[Words, ...]:
    """Return what to say where used targets were nearer, farther or nearer to the image's edge."""
    covered = calibration.covered
    used = [o for o, use in zip(solution.observations, solution.used, strict=True) if use]
    if covered is None or not used or not solution.determined:
        return ()
    told = []
    near, far = covered.distance_mm
    depth = _depths(solution, part, calibration)
    if depth.min() < near * (1 - _SLACK) or depth.max() > far * (1 + _SLACK):
        told.append(
            keyed(
                "said.outside_distance",
                "the targets were {near} to {far} mm before the camera, its calibration covers"
                " {covered_near} to {covered_far} mm: outside, it is extrapolated",
                near=f"{depth.min():.0f}", far=f"{depth.max():.0f}",
                covered_near=f"{near:.0f}", covered_far=f"{far:.0f}",
            )
        )  # fmt: skip
    pixels = np.array([o.center_px for o in used])
    slack = _SLACK * np.array([calibration.width_px, calibration.height_px])
    outside = (pixels < covered.low_px - slack) | (pixels > covered.high_px + slack)
    if outside.any():
        told.append(
            keyed(
                "said.outside_image",
                "{n} of {all} targets were seen nearer to the image's edge than the dots of the"
                " calibration: there it is extrapolated",
                n=str(int(outside.any(axis=1).sum())), all=str(len(used)),
            )
        )  # fmt: skip
    return tuple(told)


def _depths(solution: Solution, part: Part, calibration: CameraCalibration) -> Array:
    """Return the distance along the optical axis of each target used, mm."""
    theta = solution.theta
    alpha, beta, gamma = (float(angle) for angle in theta[:3])
    machine_T_part = RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, theta[3:6])
    axis = calibration.taper_T_camera.rotation[:, 2]
    holder = holder_rotation(float(theta[6]))
    depths = []
    for o, use in zip(solution.observations, solution.used, strict=True):
        target = part.target(o.target_id) if use else None
        if target is None:
            continue
        spindle = o.machine_T_spindle
        from_spindle = (machine_T_part @ target.xyz_mm - spindle.translation_mm) @ spindle.rotation
        in_taper = from_spindle @ holder
        depths.append(float((in_taper - calibration.taper_T_camera.translation_mm) @ axis))
    return np.array(depths)
