"""Where a hand-held camera sees a point: Brown's lens from ideal to measured, with affinity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.adjustment.problem import Values

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# f in px; the principal point from the middle of the picture; K and P for normalised coordinates.
PARAMETERS = (
    "focal_length_px", "cl0_px", "rw0_px", "k1", "k2", "k3", "p1", "p2", "affinity", "shear",
)  # fmt: skip


def project(values: Values, photo: Index, point: Index, middle_px: Array) -> tuple[Array, Array]:
    """Return pixels (M, 2) and points in the camera (M, 3), of rays photo -> point; one lens."""
    rotations = Rotation.from_rotvec(values["photos"][:, :3]).as_matrix()
    offset = values["points"][point] - values["photos"][photo, 3:]
    inside = np.einsum("mij,mj->mi", rotations[photo], offset)
    return _lens(values["lens"][0], inside)[0] + middle_px, inside


def lens_rows(lenses: Array, camera: Index | None) -> Array:
    """Return the lens (10,) where there is one, else that of each ray, (M, 10)."""
    return lenses[0] if camera is None or len(lenses) == 1 else lenses[camera]


def evaluate_rays(
    values: Values,
    photo: NDArray[np.intp],
    point: NDArray[np.intp],
    middle_px: Array,
    camera: Index | None = None,
) -> tuple[Array, dict[str, Array]]:
    """Return pixels (M, 2) and their derivatives by lens, photo (turn, place) and point.

    ``camera`` (M,) is the row of each ray's lens; the first where not given.
    """
    rotations = Rotation.from_rotvec(values["photos"][:, :3]).as_matrix()[photo]
    offset = values["points"][point] - values["photos"][photo, 3:]
    inside = np.einsum("mij,mj->mi", rotations, offset)
    pixels, by_lens, by_normalised = _lens(lens_rows(values["lens"], camera), inside)
    normalised = inside[:, :2] / inside[:, 2:]
    pinhole = np.zeros((len(inside), 2, 3))
    pinhole[:, 0, 0] = pinhole[:, 1, 1] = 1.0 / inside[:, 2]
    pinhole[:, :, 2] = -normalised / inside[:, 2:]
    by_inside = by_normalised @ pinhole
    by_point = by_inside @ rotations
    by_turn = np.cross(inside[:, None, :], by_inside)  # d(inside) = turn x inside
    by_photo = np.concatenate([by_turn, -by_point], axis=2)
    return pixels + middle_px, {"lens": by_lens, "photos": by_photo, "points": by_point}


def turn_and_shift(values: Array, step: Array) -> Array:
    """Apply steps (n, 6): a small turn in the camera, a shift of its place."""
    step = np.asarray(step).reshape(values.shape)
    turned = Rotation.from_rotvec(step[:, :3]) * Rotation.from_rotvec(values[:, :3])
    return np.hstack([turned.as_rotvec(), values[:, 3:] + step[:, 3:]])


def undistorted(lens: Array, offsets_px: Array) -> Array:
    """Return ideal (x/z, y/z), (M, 2), of pixels measured from the middle of the picture.

    ``lens`` is one (10,), or that of each ray (M, 10).
    """
    f, c, affinity, shear = lens[..., :1], lens[..., 1:3], lens[..., 8], lens[..., 9]
    measured = (offsets_px - c) / f
    measured[:, 0] = (measured[:, 0] - shear * measured[:, 1]) / (1.0 + affinity)
    ideal = measured.copy()
    plain = np.array(lens)
    plain[..., 0], plain[..., 1:3], plain[..., 8:] = 1.0, 0.0, 0.0
    for _ in range(20):
        ones = np.column_stack([ideal, np.ones(len(ideal))])
        ideal = ideal + measured - _lens(plain, ones)[0]
    return ideal


def lens_pixels(lens: Array, inside: Array) -> Array:
    """Return offsets from the middle of the picture (M, 2), px, of points in the camera (M, 3).

    ``lens`` is one (10,), or that of each point (M, 10).
    """
    return _lens(lens, inside)[0]


def _lens(lens: Array, inside: Array) -> tuple[Array, Array, Array]:
    """Return offsets (M, 2) px, their derivatives by the lens (M, 2, 10) and by (x/z, y/z)."""
    f, cl, rw, k1, k2, k3, p1, p2, affinity, shear = lens.T
    x, y = (inside[:, :2] / inside[:, 2:]).T
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    xd = x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
    yd = y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    by_normalised = np.empty((len(x), 2, 2))
    by_normalised[:, 0, 0] = radial + x * x * slope + 6 * p1 * x + 2 * p2 * y
    by_normalised[:, 0, 1] = x * y * slope + 2 * p1 * y + 2 * p2 * x
    by_normalised[:, 1, 0] = x * y * slope + 2 * p2 * x + 2 * p1 * y
    by_normalised[:, 1, 1] = radial + y * y * slope + 6 * p2 * y + 2 * p1 * x
    stretch = np.zeros((*np.shape(f), 2, 2))
    stretch[..., 0, 0], stretch[..., 0, 1], stretch[..., 1, 1] = f + f * affinity, f * shear, f
    by_lens = np.zeros((len(x), 2, 10))
    wide = (1.0 + affinity) * xd + shear * yd
    by_lens[:, 0, 0], by_lens[:, 1, 0] = wide, yd
    by_lens[:, 0, 1] = by_lens[:, 1, 2] = 1.0
    terms = [(x * r2, y * r2), (x * r2**2, y * r2**2), (x * r2**3, y * r2**3)]
    terms += [(r2 + 2 * x * x, 2 * x * y), (2 * x * y, r2 + 2 * y * y)]
    for column, (along, down) in enumerate(terms, start=3):
        by_lens[:, 0, column] = f * ((1.0 + affinity) * along + shear * down)
        by_lens[:, 1, column] = f * down
    by_lens[:, 0, 8], by_lens[:, 0, 9] = f * xd, f * yd
    return np.column_stack([f * wide + cl, f * yd + rw]), by_lens, stretch @ by_normalised
