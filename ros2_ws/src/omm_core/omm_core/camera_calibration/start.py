"""A camera from nothing but the sensor's size and known places (Tsai 1987, radial alignment).

The direction in which a point's image lies from the principal point does not depend on the focal
length, the distance or radial distortion::

    x (r2 · X + ty) = y (r1 · X + tx)

is linear and homogeneous in (r1, tx, r2, ty); then f and tz follow from x (r3 · X + tz) =
f (r1 · X + tx). Places in one plane leave f and tz open; a middle focal length then is the start,
with the camera along the taper's axis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.camera_calibration.model import Sensor
from omm_core.geometry import euler_xyz_rad_from_rotation

Array = NDArray[np.float64]


def start_from_places(sensor: Sensor, places: Array, pixels: Array) -> list[Array]:
    """Return camera vectors (13,) from which to adjust, the likeliest first.

    Parameters
    ----------
    sensor : Sensor
    places : (N, 3) array
        In the taper's frame, mm.
    pixels : (N, 2) array
        (col, row).
    """
    xy = pixels - [(sensor.width_px - 1) / 2, (sensor.height_px - 1) / 2]
    starts = [_along_the_axis(sensor, places, xy, scale) for scale in (1.0, 2.0, 0.5, 4.0)]
    radial = _radial_alignment(sensor, places, xy)
    return starts if radial is None else [radial, *starts]


def _radial_alignment(sensor: Sensor, places: Array, xy: Array) -> Array | None:
    middle, size = places.mean(axis=0), float(np.ptp(places, axis=0).max()) or 1.0
    x, y = (xy / sensor.width_px).T
    known = np.column_stack([(places - middle) / size, np.ones(len(places))])
    matrix = np.column_stack([y[:, None] * known, -x[:, None] * known])
    if len(matrix) < 8:
        return None
    _, values, vectors = np.linalg.svd(matrix, full_matrices=False)
    if values[-2] < 1e-4 * values[0]:
        return None
    q = vectors[-1]
    r1, r2 = q[:3] / np.linalg.norm(q[:3]), q[4:7] / np.linalg.norm(q[4:7])
    u, _, vt = np.linalg.svd(np.stack([r1, r2]), full_matrices=False)
    r1, r2 = u @ vt
    scale = size / np.mean([np.linalg.norm(q[:3]), np.linalg.norm(q[4:7])])
    tx, ty = q[3] * scale, q[7] * scale
    side = np.sum(xy * (np.stack([r1, r2]) @ (places - middle).T + [[tx], [ty]]).T)
    if side < 0:
        r1, r2, tx, ty = -r1, -r2, -tx, -ty
    return _distance_and_focal_length(sensor, places - middle, xy, (r1, r2, tx, ty), middle)


def _distance_and_focal_length(
    sensor: Sensor,
    centred: Array,
    xy: Array,
    frame: tuple[Array, Array, float, float],
    middle: Array,
) -> Array | None:
    r1, r2, tx, ty = frame
    rotation = np.stack([r1, r2, np.cross(r1, r2)])
    p = centred @ rotation.T + [tx, ty, 0.0]
    matrix = np.concatenate([np.column_stack([p[:, i], -xy[:, i]]) for i in range(2)])
    right = np.concatenate([xy[:, i] * p[:, 2] for i in range(2)])
    f_px, tz = np.linalg.lstsq(matrix, right, rcond=None)[0]
    if f_px <= 0 or np.min(p[:, 2] + tz) <= 0:
        return None
    position = middle - rotation.T @ [tx, ty, tz]
    return _camera(f_px * sensor.pixel_size_mm, position, rotation.T)


def _along_the_axis(sensor: Sensor, places: Array, xy: Array, scale: float) -> Array:
    """Return a camera that looks along -z of the taper, by a similarity of the two images."""
    f_px = scale * sensor.width_px
    flat = (places[:, 0] - 1j * places[:, 1]) - (places[:, 0] - 1j * places[:, 1]).mean()
    image = xy[:, 0] + 1j * xy[:, 1]
    about = image - image.mean()
    power = float(np.sum(np.abs(flat) ** 2))
    factor = complex(np.sum(np.conj(flat) * about)) / power if power > 0 else 1.0 + 0j
    size, roll = abs(factor) or 1.0, float(np.angle(factor))
    turned = np.array(
        [[np.cos(roll), np.sin(roll), 0], [np.sin(roll), -np.cos(roll), 0], [0, 0, -1]]
    )
    distance = f_px / size
    centre = places.mean(axis=0)
    sideways = turned.T @ np.array([image.mean().real / size, image.mean().imag / size, 0.0])
    position = centre - sideways + [0.0, 0.0, distance]
    return _camera(f_px * sensor.pixel_size_mm, position, turned.T)


def _camera(focal_length_mm: float, position: Array, rotation: Array) -> Array:
    camera = np.zeros(13)
    camera[0], camera[7:10] = focal_length_mm, position
    alpha, beta, gamma = euler_xyz_rad_from_rotation(rotation)
    camera[10:] = alpha % (2 * np.pi), beta, gamma  # about pi: the camera looks along -z
    return camera
