"""Where dots appear for a camera of 13 parameters, with derivatives by all of them.

A camera is a vector in the order of :data:`PARAMETERS`. Dots are given by the points of their
outlines in the taper's frame (``omm_core.imaging.circle``), so that not the image of a dot's
centre is predicted, but the centre of its image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import rotation_from_euler_xyz_rad
from omm_core.imaging.circle import centre_weights_of_many
from omm_core.imaging.lens import BrownPhotogrammetric

Array = NDArray[np.float64]

PARAMETERS = (
    "focal_length_mm", "cl0_px", "rw0_px", "k1_px2", "k2_px4", "p1_px", "p2_px",
    "x_mm", "y_mm", "z_mm", "alpha_rad", "beta_rad", "gamma_rad",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """The camera's sensor: name, size, pixel."""

    name: str
    width_px: int
    height_px: int
    pixel_size_mm: float

    def lens(self, camera: Array) -> BrownPhotogrammetric:
        """Return the lens of a camera vector (13,)."""
        names = PARAMETERS[:7]
        return BrownPhotogrammetric(
            width_px=self.width_px,
            height_px=self.height_px,
            pixel_size_mm=self.pixel_size_mm,
            **dict(zip(names, (float(v) for v in camera[:7]), strict=True)),
        )


def skew(v: Array) -> Array:
    """Return the matrix of ``v ×``."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation_derivatives(euler_xyz_rad: Array) -> Array:
    """Return the derivatives of R by alpha, beta, gamma; (3, 3, 3), the angle first."""
    rotation = rotation_from_euler_xyz_rad(*euler_xyz_rad)
    axis_y = rotation_from_euler_xyz_rad(0.0, 0.0, euler_xyz_rad[2])[:, 1]
    return np.stack(
        [
            rotation @ skew(np.array([1.0, 0.0, 0.0])),
            skew(axis_y) @ rotation,
            skew(np.array([0.0, 0.0, 1.0])) @ rotation,
        ]
    )


def project_with_derivatives(
    sensor: Sensor, camera: Array, outlines_in_taper: Array
) -> tuple[Array, Array, Array]:
    """Return the centres of the images of dots.

    Parameters
    ----------
    sensor : Sensor
    camera : (13,) array
        In the order of PARAMETERS.
    outlines_in_taper : (N, K, 3) array
        Points of the outlines of the dots, mm; K = 1 for points.

    Returns
    -------
    centres : (N, 2) array
        (col, row) px; NaN where the lens does not see a dot.
    by_camera : (N, 2, 13) array
    by_outline : (N, K, 2, 3) array
        By each point of the outline, px/mm.
    """
    n, k, _ = outlines_in_taper.shape
    lens = sensor.lens(camera)
    rotation = rotation_from_euler_xyz_rad(*camera[10:])
    from_camera = (outlines_in_taper - camera[7:10]).reshape(-1, 3)
    p = from_camera @ rotation
    pixels, by_point = lens.project_with_jacobian(p)
    by_camera = np.empty((n * k, 2, 13))
    by_camera[:, :, :7] = _by_lens(lens, p, pixels, by_point)
    by_taper = by_point @ rotation.T
    by_camera[:, :, 7:10] = -by_taper
    for angle, derivative in enumerate(rotation_derivatives(camera[10:])):
        turned = from_camera @ derivative
        by_camera[:, :, 10 + angle] = np.einsum("nij,nj->ni", by_point, turned)
    if k == 1:
        return pixels, by_camera, by_taper[:, None]
    outline = pixels.reshape(n, k, 2)
    weights = centre_weights_of_many(outline)
    return (
        np.einsum("nkij,nkj->ni", weights, outline),
        np.einsum("nkij,nkjp->nip", weights, by_camera.reshape(n, k, 2, 13)),
        weights @ by_taper.reshape(n, k, 2, 3),
    )


def _by_lens(lens: BrownPhotogrammetric, p: Array, pixels: Array, by_point: Array) -> Array:
    """Return d(pixel)/d(f, cl0, rw0, k1, k2, p1, p2), (N, 2, 7).

    From F(x, y; k) = f n: dF/d(x, y) is the inverse of the derivative that the lens tells; its
    derivative by n = (u/w, v/w) is w times that by (u, v).
    """
    normalised = p[:, :2] / p[:, 2:]
    by_normalised = by_point[:, :, :2] * p[:, 2, None, None]
    x, y = (pixels - lens.principal_point_px).T
    r2 = x * x + y * y
    ideal = np.stack(
        [
            np.stack([x * r2, y * r2], axis=1),
            np.stack([x * r2**2, y * r2**2], axis=1),
            np.stack([r2 + 2 * x * x, 2 * x * y], axis=1),
            np.stack([2 * x * y, r2 + 2 * y * y], axis=1),
        ],
        axis=2,
    )
    result = np.zeros((len(p), 2, 7))
    result[:, :, 0] = np.einsum("nij,nj->ni", by_normalised, normalised) / lens.focal_length_mm
    result[:, 0, 1] = result[:, 1, 2] = 1.0
    result[:, :, 3:] = -(by_normalised @ ideal) / lens.principal_distance_px
    return result
