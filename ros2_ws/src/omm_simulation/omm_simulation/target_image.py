"""Images of ring-coded targets with exact area coverage, to test against.

A target is drawn into pixels through any smooth mapping from pixels to the target's plane. Near
edges each pixel is divided into k × k cells; each cell is cut by the edge as a straight line, so
the area is exact up to the edge's curvature within 1/k pixel. The blur is applied to the cells,
before they are summed to pixels: the result is the convolution of the true shape with the point
spread function and the pixel's square, sampled at the pixels. For a dot of 8 px at k = 4 the centre
is right to better than 0.0002 px.

Only coverage (0 = background, 1 = set) is made here; grey values are up to the caller::

    coverage = target_coverage(code=71, family=family, dot_radius_mm=4.0, ...)
    image[rows, cols] = dark + (bright - dark) * coverage     # or the other polarity
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from omm_core.targets.coded.families import TargetFamily

Floats = NDArray[np.float64]
PlaneOfPixel = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Maps arrays of col, row (px) to x, y (mm) in the target's plane: x right, y up for the viewer."""


def target_coverage(
    *,
    code: int,
    family: TargetFamily,
    dot_radius_mm: float,
    plane_of_pixel: PlaneOfPixel,
    window: tuple[int, int, int, int],
    blur_px: float = 0.0,
    phase_rad: float = 0.0,
    cells: int = 4,
    ring: bool = True,
) -> Floats:
    """Draw the set areas of one target.

    Parameters
    ----------
    code : bits of the ring, most significant first, clockwise as the viewer sees them, beginning
        at the target's +x axis turned clockwise by `phase_rad`.
    dot_radius_mm : radius of the dot; the ring's radii follow from the family.
    plane_of_pixel : see `PlaneOfPixel`; evaluated at the pixels' centres, quadratic in between.
    window : (col0, row0, width, height) in pixels of what is drawn.
    blur_px : standard deviation of the Gaussian point spread function.
    cells : k, cells per pixel and direction.
    ring : False draws the dot alone.

    Returns
    -------
    Coverage from 0 to 1, shape (height, width).
    """
    inner = family.ring_inner_ratio * dot_radius_mm
    outer = family.ring_outer_ratio * dot_radius_mm
    bits = np.array(
        [(code >> (family.bits - 1 - i)) & 1 for i in range(family.bits)], dtype=np.float64
    )
    if not ring:
        bits[:] = 0.0

    def draw(x: Floats, y: Floats, k: int) -> Floats:
        return _target_cells(x, y, k, dot_radius_mm, inner, outer, bits, phase_rad)

    return blurred_cells(draw, plane_of_pixel, window, blur_px, cells)


def blurred_cells(
    draw: Callable[[Floats, Floats, int], Floats],
    plane_of_pixel: PlaneOfPixel,
    window: tuple[int, int, int, int],
    blur_px: float,
    cells: int,
) -> Floats:
    """Let `draw` cover the cells of a window, blur them and sum them to pixels.

    `draw` gets x and y (mm) at the centres of the window's pixels, with a margin for the blur and
    one more pixel all around, and returns the coverage of the k × k cells of all but this last.
    """
    col0, row0, width, height = window
    margin = math.ceil(5.0 * blur_px)
    cols = np.arange(col0 - margin - 1, col0 + width + margin + 1, dtype=np.float64)
    rows = np.arange(row0 - margin - 1, row0 + height + margin + 1, dtype=np.float64)
    x, y = plane_of_pixel(*np.meshgrid(cols, rows))
    fine = draw(np.ascontiguousarray(x), np.ascontiguousarray(y), cells)
    weights = _pixel_weights(blur_px, margin, cells)
    return _reduce(_reduce(fine, weights, cells).T, weights, cells).T


def disc_coverage(
    *,
    centre_mm: tuple[float, float],
    radius_mm: float,
    plane_of_pixel: PlaneOfPixel,
    window: tuple[int, int, int, int],
    blur_px: float = 0.0,
    cells: int = 4,
) -> Floats:
    """Draw one disc; parameters as in `target_coverage`."""

    def draw(x: Floats, y: Floats, k: int) -> Floats:
        shifted = (x - centre_mm[0], y - centre_mm[1])
        return _target_cells(
            *shifted, k, radius_mm, 2.0 * radius_mm, 3.0 * radius_mm, np.zeros(12), 0.0
        )

    return blurred_cells(draw, plane_of_pixel, window, blur_px, cells)


def affine_plane(
    *,
    centre_px: tuple[float, float],
    radius_px: float,
    tilt_rad: float = 0.0,
    axis_rad: float = 0.0,
) -> PlaneOfPixel:
    """Return the mapping of a distant tilted target; its plane is measured in dot radii.

    `radius_px` is the ellipse's larger semi-axis; the plane is tilted by `tilt_rad` about the
    direction `axis_rad` in the image (from col towards row).
    """
    ca, sa, ct = math.cos(axis_rad), math.sin(axis_rad), math.cos(tilt_rad)

    def plane_of_pixel(col: Floats, row: Floats) -> tuple[Floats, Floats]:
        dc, dr = col - centre_px[0], row - centre_px[1]
        along = (ca * dc + sa * dr) / radius_px
        across = (-sa * dc + ca * dr) / (radius_px * ct)
        return ca * along - sa * across, -(sa * along + ca * across)

    return plane_of_pixel


def _pixel_weights(blur_px: float, margin: int, k: int) -> Floats:
    """Return the weights of the cells for one pixel: the Gaussian, summed over its k cells."""
    if margin == 0:
        return np.full(k, 1.0 / k)
    offsets = np.arange(-margin * k, margin * k + 1) / k
    gauss = np.exp(-0.5 * (offsets / blur_px) ** 2)
    return np.convolve(gauss / gauss.sum(), np.full(k, 1.0 / k))


@numba.njit(cache=True, nogil=True)
def _reduce(fine, weights, k):
    """Return weighted sums along the second axis, one per k cells."""
    rows = fine.shape[0]
    cols = (fine.shape[1] - len(weights)) // k + 1
    out = np.empty((rows, cols))
    for r in range(rows):
        for c in range(cols):
            total = 0.0
            for i in range(len(weights)):
                total += weights[i] * fine[r, c * k + i]
            out[r, c] = total
    return out


@numba.njit(cache=True, nogil=True)
def _half_plane(distance, a, b):
    """Return the area of a unit square where a u + b v + distance > 0 (a, b: gradient)."""
    a, b = abs(a), abs(b)
    if a < b:
        a, b = b, a
    outer, inner = 0.5 * (a + b), 0.5 * (a - b)
    s = abs(distance)
    if s >= outer:
        area = 0.0
    elif s <= inner:
        area = 0.5 - s / a
    else:
        area = 0.5 * (outer - s) ** 2 / (a * b)
    return area if distance < 0.0 else 1.0 - area


@numba.njit(cache=True, nogil=True)
def _cover(x, y, sides, dot, inner, outer, bits, phase):
    """Return the coverage of one cell around (x, y) with its sides in the plane."""
    jxu, jxv, jyu, jyv = sides
    r = math.sqrt(x * x + y * y)
    if r < 1e-9:
        return 1.0
    gu, gv = (x * jxu + y * jyu) / r, (x * jxv + y * jyv) / r
    if r < 0.5 * (dot + inner):
        return _half_plane(dot - r, gu, gv)
    band = _half_plane(r - inner, gu, gv) - _half_plane(r - outer, gu, gv)
    if band == 0.0:
        return 0.0
    n = len(bits)
    pitch = 2.0 * math.pi / n
    turn = (math.atan2(-y, x) - phase) / pitch
    k = math.floor(turn + 0.5)  # the sector border next to the cell
    border = phase + k * pitch
    before, after = bits[(k - 1) % n], bits[k % n]
    if before == after:
        return band * after
    # Signed distance from the border, positive clockwise: towards the later sector.
    sb, cb = math.sin(border), math.cos(border)
    beyond = _half_plane(-x * sb - y * cb, -jxu * sb - jyu * cb, -jxv * sb - jyv * cb)
    return band * (before + (after - before) * beyond)


@numba.njit(cache=True, nogil=True)
def _target_cells(x, y, k, dot, inner, outer, bits, phase):
    rows, cols = x.shape[0] - 2, x.shape[1] - 2
    fine = np.empty((rows * k, cols * k))
    for r in range(1, rows + 1):
        for c in range(1, cols + 1):
            xu, xv = 0.5 * (x[r, c + 1] - x[r, c - 1]), 0.5 * (x[r + 1, c] - x[r - 1, c])
            yu, yv = 0.5 * (y[r, c + 1] - y[r, c - 1]), 0.5 * (y[r + 1, c] - y[r - 1, c])
            xuu, xvv = (
                x[r, c + 1] + x[r, c - 1] - 2 * x[r, c],
                x[r + 1, c] + x[r - 1, c] - 2 * x[r, c],
            )
            yuu, yvv = (
                y[r, c + 1] + y[r, c - 1] - 2 * y[r, c],
                y[r + 1, c] + y[r - 1, c] - 2 * y[r, c],
            )
            xuv = 0.25 * (x[r + 1, c + 1] + x[r - 1, c - 1] - x[r + 1, c - 1] - x[r - 1, c + 1])
            yuv = 0.25 * (y[r + 1, c + 1] + y[r - 1, c - 1] - y[r + 1, c - 1] - y[r - 1, c + 1])
            for i in range(k):
                v = (i + 0.5) / k - 0.5
                for j in range(k):
                    u = (j + 0.5) / k - 0.5
                    px = x[r, c] + xu * u + xv * v + 0.5 * (xuu * u * u + xvv * v * v) + xuv * u * v
                    py = y[r, c] + yu * u + yv * v + 0.5 * (yuu * u * u + yvv * v * v) + yuv * u * v
                    sides = (xu / k, xv / k, yu / k, yv / k)
                    fine[(r - 1) * k + i, (c - 1) * k + j] = _cover(
                        px, py, sides, dot, inner, outer, bits, phase
                    )
    return fine
