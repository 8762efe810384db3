"""A camera and a plate's pose to start from, out of a run: the 7D problem for trial lenses.

With the camera at the spindle's nose, looking along its axis, γ_s takes the camera's roll, and the
plate's height takes the camera's; the focal length is that of the trials which fits best.
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
    best: tuple[float, Array, Array] | None = None
    for f_mm in trials if hint is None else [float(hint[0]), *trials]:
        found = _trial(sensor, seen, part, f_mm)
        if found is not None and (best is None or found[0] < best[0]):
            best = found
    if best is None:
        raise MeasurementError(
            "No pose of the plate fits the images, whatever the focal length. Check the plate's"
            " coordinates and its family, and that the plate did not move."
        )
    return best[1], best[2]


def _trial(
    sensor: Sensor, seen: Sequence[Observation], part: Part, f_mm: float
) -> tuple[float, Array, Array] | None:
    camera = np.zeros(13)
    camera[0] = f_mm
    calibration = CameraCalibration(
        name=sensor.name,
        lens=sensor.lens(camera),
        taper_T_camera=RigidTransform.from_euler_xyz_rad(np.pi, 0.0, 0.0),
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
