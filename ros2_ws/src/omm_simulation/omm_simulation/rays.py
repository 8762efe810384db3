"""Which way each pixel looks, and what it sees of a plane: the renderer's own geometry.

Written from the contract's equations a second time, on purpose: the estimator's model
(`omm_core`) is tested against images that were made without it.
"""

from typing import TypeAlias

import numba
import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.imaging.lens import BrownPhotogrammetric, Lens, PlumbBob

Floats = NDArray[np.float64]
LensNumbers: TypeAlias = Floats
"""[model, focal x, focal y, centre col, centre row, k1, k2, k3, p1, p2]"""

_BROWN, _PLUMB_BOB = 0.0, 1.0


def lens_numbers(lens: Lens) -> LensNumbers:
    """Return a lens as the kernels below take it."""
    if isinstance(lens, BrownPhotogrammetric):
        focal_px = lens.focal_length_mm / lens.pixel_size_mm
        col, row = (lens.width_px - 1) / 2 + lens.cl0_px, (lens.height_px - 1) / 2 + lens.rw0_px
        distortion = [lens.k1_px2, lens.k2_px4, 0.0, lens.p1_px, lens.p2_px]
        return np.array([_BROWN, focal_px, focal_px, col, row, *distortion])
    if isinstance(lens, PlumbBob):
        distortion = [lens.k1, lens.k2, lens.k3, lens.p1, lens.p2]
        return np.array([_PLUMB_BOB, lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, *distortion])
    raise InputError(f"Expected a Brown or plumb_bob lens, got {type(lens).__name__}.")


@numba.njit(cache=True, nogil=True)
def ray_of_pixel(lens: LensNumbers, col: float, row: float) -> tuple[float, float]:
    """Return (u/w, v/w) of the ray that ends in a point of the image."""
    k1, k2, k3, p1, p2 = lens[5], lens[6], lens[7], lens[8], lens[9]
    if lens[0] == _BROWN:  # measured to ideal is the closed direction
        x, y = col - lens[3], row - lens[4]
        r2 = x * x + y * y
        radial = r2 * (k1 + r2 * k2)
        x_ideal = x + x * radial + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y
        y_ideal = y + y * radial + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y
        return x_ideal / lens[1], y_ideal / lens[2]
    x_seen, y_seen = (col - lens[3]) / lens[1], (row - lens[4]) / lens[2]
    x, y = x_seen, y_seen
    for _ in range(60):  # ideal to distorted is the closed direction: a fixed point of its inverse
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x_next = (x_seen - 2.0 * p1 * x * y - p2 * (r2 + 2.0 * x * x)) / radial
        y_next = (y_seen - p1 * (r2 + 2.0 * y * y) - 2.0 * p2 * x * y) / radial
        change = abs(x_next - x) + abs(y_next - y)
        x, y = x_next, y_next
        if change < 1e-15:
            break
    return x, y


def plane_homography(camera_R_plane: Floats, plane_in_camera_mm: Floats) -> Floats:
    """Return the homography from rays to the plane's own coordinates, shape (3, 3).

    The ray r = (u/w, v/w, 1) meets the plane through c with the axes e1, e2 and the normal n at
    t·r with t = (n·c) / (n·r); there, the plane's coordinates are e·(t r − c). As a homography:
    (a, b, d) = H r, coordinates = (a/d, b/d) in mm.

    Parameters
    ----------
    camera_R_plane : ndarray, shape (3, 3)
        Columns e1, e2, n in `camera_optical`.
    plane_in_camera_mm : ndarray, shape (3,)
        c, the plane's origin.
    """
    e1, e2, n = camera_R_plane.T
    c = plane_in_camera_mm
    return np.array([(n @ c) * e1 - (e1 @ c) * n, (n @ c) * e2 - (e2 @ c) * n, n])


@numba.njit(cache=True, nogil=True)
def see_plane(lens: LensNumbers, homography: Floats, pixels: Floats) -> Floats:
    """Return where points of the image (N, 2) see a plane, in its coordinates (N, 2) in mm."""
    seen = np.empty_like(pixels)
    for i in range(len(pixels)):
        x, y = ray_of_pixel(lens, pixels[i, 0], pixels[i, 1])
        depth = homography[2, 0] * x + homography[2, 1] * y + homography[2, 2]
        for k in range(2):
            along = homography[k, 0] * x + homography[k, 1] * y + homography[k, 2]
            seen[i, k] = along / depth
    return seen
