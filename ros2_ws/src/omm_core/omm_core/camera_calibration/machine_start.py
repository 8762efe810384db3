"""A camera and a plate's pose to start from, out of a run: the 7D problem for trial lenses.

With the camera at the spindle's nose, looking along its axis, γ_s takes the camera's roll, and the
plate's height takes the camera's; the focal length is that of the trials which fits best. Where the
spindle's axis tilts, the plate cannot take the camera's height: several of those are tried, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omm_core.camera_calibration.model import Sensor
from omm_core.errors import MeasurementError
from omm_core.files.part import Part
from omm_core.geometry import RigidTransform, euler_xyz_rad_from_rotation, holder_rotation
from omm_core.imaging.calibration import CameraCalibration
from omm_core.part_pose import Observation, SolveOptions, build_problem
from omm_core.part_pose.adjustment import adjust

Array = NDArray[np.float64]

# Focal lengths as multiples of the sensor's width: from fish-eye to long.
_TRIALS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 6.0)
# Heights of the camera in the taper frame to try where the spindle tilts, mm.
_HEIGHTS_MM = (0.0, -100.0, -200.0, -300.0, -400.0)
# Axes that differ by no more than this are parallel: 500 mm of height then move less than 0.1 mm.
_PARALLEL_RAD = 1e-4


def spindle_tilts(rotations: Array) -> bool:
    """Return whether the spindle's axes (of rotations, (S, 3, 3)) are not all parallel."""
    axes = rotations[:, :, 2]
    away = np.linalg.norm(np.cross(axes, axes[0]), axis=1)
    return bool(away.max() > _PARALLEL_RAD)


def start_from_run(
    sensor: Sensor, seen: Sequence[Observation], part: Part, hint: Array | None
) -> tuple[Array, Array]:
    """Return a camera vector (13,) and the plate's pose (alpha, beta, gamma, x, y, z).

    Raises
    ------
    MeasurementError
        If no trial fits at all.
    """
    width = sensor.width_px * sensor.pixel_size_mm
    trials = [scale * width for scale in _TRIALS]
    tilts = spindle_tilts(np.array([o.machine_T_spindle.rotation for o in seen]))
    heights = _HEIGHTS_MM if tilts else (0.0,)
    starts = [(f_mm, z_mm) for z_mm in heights for f_mm in trials]
    if hint is not None:
        starts.insert(0, (float(hint[0]), float(hint[9]) if tilts else 0.0))
    best: tuple[float, Array, Array] | None = None
    for f_mm, z_mm in starts:
        found = _trial(sensor, seen, part, f_mm, z_mm)
        if found is not None and (best is None or found[0] < best[0]):
            best = found
    if best is None:
        raise MeasurementError(
            "No pose of the plate fits the images, whatever the focal length. Check the plate's"
            " coordinates and its family, and that the plate did not move."
        )
    return best[1], best[2]


def _trial(
    sensor: Sensor, seen: Sequence[Observation], part: Part, f_mm: float, z_mm: float
) -> tuple[float, Array, Array] | None:
    camera = np.zeros(13)
    camera[0], camera[9] = f_mm, z_mm
    calibration = CameraCalibration(
        name=sensor.name,
        lens=sensor.lens(camera),
        taper_T_camera=RigidTransform.from_euler_xyz_rad(np.pi, 0.0, 0.0, (0.0, 0.0, z_mm)),
        covariance=np.zeros((0, 0)),
    )
    # No noise but that of pixels, and no judgement on what is determined: it is a start.
    problem = build_problem(seen, part, calibration)
    minima = adjust(problem, SolveOptions(find_errors=False))
    if not minima:
        return None
    theta = minima[0].theta(problem.X0_mm)
    looking = holder_rotation(float(theta[6])) @ calibration.taper_T_camera.rotation
    alpha, beta, gamma = euler_xyz_rad_from_rotation(looking)
    camera[10:] = alpha % (2 * np.pi), beta, gamma
    return float(minima[0].cost), camera, np.array(theta[:6])
