"""What a calibration allows of a measurement: the 7D result's sigma from the camera alone.

The standard measurement: targets in the corners of a square of 1 m, each seen four times from 300
mm, once in each quarter of the image, by an exact machine without image noise. The least squares
then carry an error of the camera over as ``δθ = -(JᵀJ)⁻¹ Jᵀ B δc``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.camera_calibration.model import Sensor, project_with_derivatives, skew
from omm_core.geometry import rotation_from_euler_xyz_rad

Array = NDArray[np.float64]

DISTANCE_MM = 300.0
_SIDE_MM = 1000.0
_QUARTER = 0.25


def result_sigma(sensor: Sensor, camera: Array, covariance: Array) -> Array:
    """Return the sigma of (α, β, γ, x, y, z, γ_s) that the camera's covariance (13, 13) makes.

    rad and mm; x, y, z are those of the square's middle.
    """
    _, gain, by_camera = standard_measurement(sensor, camera)
    carried = gain @ by_camera
    return np.sqrt(np.diag(carried @ covariance @ carried.T).clip(0.0))


def standard_measurement(sensor: Sensor, camera: Array) -> tuple[Array, Array, Array]:
    """Return the pixels (n, 2), d(result)/d(pixels) (7, 2n), and d(pixels)/d(camera) (2n, 13)."""
    lens = sensor.lens(camera)
    size = np.array([sensor.width_px, sensor.height_px])
    middle = (size - 1) / 2
    quarters = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * _QUARTER * size + middle
    seen = lens.rays(quarters) * DISTANCE_MM
    in_taper = seen @ rotation_from_euler_xyz_rad(*camera[10:]).T + camera[7:10]
    corners = _SIDE_MM / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    by_theta, by_camera = [], []
    for corner in corners:
        _, of_camera, of_place = project_with_derivatives(sensor, camera, in_taper[:, None])
        place = of_place[:, 0]
        # The spindle is not turned: the part's axes are the taper's but for the holder's angle,
        # and R_s(γ_s) turns what is seen the other way round.
        about_part = place @ -skew(corner)
        about_axis = np.einsum("nij,nj->ni", place, in_taper @ skew(np.array([0.0, 0.0, 1.0])).T)
        by_theta.append(np.concatenate([about_part, place, about_axis[:, :, None]], axis=2))
        by_camera.append(of_camera)
    J = np.concatenate(by_theta).reshape(-1, 7)
    B = np.concatenate(by_camera).reshape(-1, 13)
    scale = 1.0 / np.linalg.norm(J, axis=0)
    gain = scale[:, None] * np.linalg.pinv(J * scale)
    return np.tile(quarters, (len(corners), 1)), gain, B
