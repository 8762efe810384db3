r"""What each pixel of a dot and of the gap around it should show.

Model of a pixel at x, with S the blurred ellipse's share of the pixel and R that of the ring:

    I(x) = B(x) + (F(x) - B(x)) (S(x) + R(x))

B and F are planes (light that falls off across dot and background), S = Φ(-d / s) with d the
distance from the ellipse and s² = blur² + 1/12 (the pixel's square). A blurred disc looks smaller
by κ s² / 2 (κ = curvature of its edge), which is taken into account.

The model is evaluated in passes over all pixels: the ones without branches run in vectors.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from omm_core.targets.conic.outline import COL, ROW, XX, XY, YY, square_root

Floats = NDArray[np.float64]

PARAMETERS = 12
BLUR, F0, FX, FY, B0, BX, BY = range(5, PARAMETERS)
"""After the conic's COL, ROW, XX, XY, YY: s, and the planes F and B (slopes per dot radius)."""
SET_PIXELS, SET_SQUARES, CLEAR_PIXELS, CLEAR_SQUARES, CHI2, PIXELS = range(6)
"""Statistics: pixels and sum of squares of each half, χ² and pixels in all."""


class Ring(NamedTuple):
    """The ring around a dot: inner radius (dot radii), bits, where they begin (rad)."""

    inner: float
    bits: NDArray[np.int64]
    phase: float


class Noise(NamedTuple):
    """The variance of a grey value I is read + gain I; from saturation on it says "at least"."""

    read: float
    gain: float
    saturation: float


class Window(NamedTuple):
    """Where the slopes' coordinates begin, the root A of the start's ellipse, its size (px)."""

    x0: float
    y0: float
    a11: float
    a12: float
    a22: float
    r0: float
    reach: float


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def window_of(start):
    """Return the window of an outline."""
    a11, a12, a22 = square_root(start[XX], start[XY], start[YY])
    r0 = math.sqrt(a11 * a22 - a12 * a12)
    reach = max(math.sqrt(a11 * a11 + a12 * a12), math.sqrt(a12 * a12 + a22 * a22))
    return Window(start[COL], start[ROW], a11, a12, a22, r0, reach)


_ROOT2 = math.sqrt(2.0)


@numba.njit(cache=True)
def _phi(z):
    return 0.5 * math.erfc(-z / _ROOT2)


_STEPS = 32.0
_NODES = np.arange(-146, 148) / _STEPS
_PHI = np.array([0.5 * math.erfc(-z / _ROOT2) for z in _NODES])
_SLOPE = np.exp(-0.5 * _NODES**2) / math.sqrt(2.0 * math.pi)


@numba.njit(cache=True, error_model="numpy")
def _phi_and_slope(z):
    """Return the normal distribution and its density for |z| <= 4.5.

    The distribution is right to 1e-8 (a cubic between nodes), the density to 1e-4.
    """
    t = (z - _NODES[0]) * _STEPS
    i = int(t)
    u = t - i
    rise, m0, m1 = _PHI[i + 1] - _PHI[i], _SLOPE[i] / _STEPS, _SLOPE[i + 1] / _STEPS
    share = _PHI[i] + u * (m0 + u * (3.0 * rise - 2.0 * m0 - m1 + u * (m0 + m1 - 2.0 * rise)))
    return share, _SLOPE[i] + u * (_SLOPE[i + 1] - _SLOPE[i])


@numba.njit(cache=True)
def _ring_share(u, v, rho, length, inner, s, bits, phase):
    """Return the ring's share of a pixel inside its inner edge (u, v in dot radii)."""
    n = len(bits)
    pitch = 2.0 * math.pi / n
    turn = (math.atan2(v, u) - phase) / pitch
    k = math.floor(turn + 0.5)
    before, after = bits[(k - 1) % n], bits[k % n]
    share = before
    if before != after:
        share += (after - before) * _phi((turn - k) * pitch * rho * length / s)
    return share * _phi((rho - inner) * length / s)


@numba.njit(cache=True, error_model="numpy")
def sort_pixels(image, start, p, inner, below, pixels, flat):
    """Sort the window's pixels (dot and gap, up to well before the ring) into edge and flat.

    Parameters
    ----------
    pixels : (3, N) out: col, row, value of the edge's pixels, and of all that may be clipped.
    flat : (2, 10) out: what the rest, wholly set [0] or wholly clear [1], tells of light: sums of
        1, tx, ty, tx², tx ty, ty², value, value tx, value ty, value².

    Returns
    -------
    Number of pixels written.
    """
    height, width = image.shape
    x0, y0, xx, xy, yy = start[COL], start[ROW], start[XX], start[XY], start[YY]
    a11, a12, a22 = square_root(xx, xy, yy)
    r0 = math.sqrt(a11 * a22 - a12 * a12)
    small = 0.5 * (a11 + a22 - math.sqrt((a11 - a22) ** 2 + 4.0 * a12 * a12))
    reach = 1.0 + 0.6 * (inner - 1.0)
    inside = max(1.0 - 4.2 * p[BLUR] / small, 0.0) ** 2
    outside = (1.0 + 4.2 * p[BLUR] / small) ** 2
    before_ring = max(inner - 4.2 * p[BLUR] / small, 0.0) ** 2
    reach_x, reach_y = reach * math.sqrt(a11**2 + a12**2), reach * math.sqrt(a12**2 + a22**2)
    c_lo, c_hi = max(int(x0 - reach_x), 0), min(int(x0 + reach_x) + 2, width)
    r_lo, r_hi = max(int(y0 - reach_y), 0), min(int(y0 + reach_y) + 2, height)
    flat[:] = 0.0
    used = 0
    for row in range(r_lo, r_hi):
        wy, dy = row - y0, row - p[ROW]
        ty = wy / r0
        for col in range(c_lo, c_hi):
            wx, dx = col - x0, col - p[COL]
            # The window stays where the start put it.
            if xx * wx * wx + 2.0 * xy * wx * wy + yy * wy * wy > reach * reach:
                continue
            square = p[XX] * dx * dx + 2.0 * p[XY] * dx * dy + p[YY] * dy * dy
            value = image[row, col] + 0.0
            if inside <= square <= outside or square >= before_ring or not 0.0 < value < below:
                pixels[0, used], pixels[1, used], pixels[2, used] = col, row, value
                used += 1
                continue
            kind = 0 if square < 1.0 else 1
            tx = wx / r0
            flat[kind, 0] += 1.0
            flat[kind, 1] += tx
            flat[kind, 2] += ty
            flat[kind, 3] += tx * tx
            flat[kind, 4] += tx * ty
            flat[kind, 5] += ty * ty
            flat[kind, 6] += value
            flat[kind, 7] += value * tx
            flat[kind, 8] += value * ty
            flat[kind, 9] += value * value
    return used


RHO, LENGTH, DISTANCE, SHARE, SLOPE = range(5)
"""Rows of `geometry`: distance from the centre (dot radii), what that times the edge's distance is
in px, distance outside of the edge (px), share of the pixel that is set, slope of that."""


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def place(pixels, used, p, geometry):
    """Fill in where the pixels lie with respect to the dot's edge."""
    s = p[BLUR]
    bulge = 0.5 * s * s * (p[XX] * p[YY] - p[XY] * p[XY])
    x, y, xx, xy, yy = p[COL], p[ROW], p[XX], p[XY], p[YY]
    for i in range(used):
        dx, dy = pixels[0, i] - x, pixels[1, i] - y
        mx, my = xx * dx + xy * dy, xy * dx + yy * dy
        square = dx * mx + dy * my
        rho = math.sqrt(square) + 1e-12
        length = rho / (math.sqrt(mx * mx + my * my) + 1e-12)
        geometry[RHO, i], geometry[LENGTH, i] = rho, length
        geometry[DISTANCE, i] = (rho - 1.0) * length + bulge * length * length * length


@numba.njit(cache=True, error_model="numpy")
def shares(pixels, geometry, used, p, window, ring):
    """Fill in how much of each pixel is set."""
    s = p[BLUR]
    inner, bits, phase = ring.inner, ring.bits, ring.phase
    a11, a12, a22 = window.a11, window.a12, window.a22
    area = a11 * a22 - a12 * a12
    for i in range(used):
        rho, length = geometry[RHO, i], geometry[LENGTH, i]
        z = -geometry[DISTANCE, i] / s
        if z > 4.5 or rho <= 0.3:
            share, slope = 1.0, 0.0
        elif z < -4.5:
            share, slope = 0.0, 0.0
        else:
            share, slope = _phi_and_slope(z)
        if (rho - inner) * length > -5.0 * s:
            dx, dy = pixels[0, i] - p[COL], pixels[1, i] - p[ROW]
            u, v = (a22 * dx - a12 * dy) / area, (a11 * dy - a12 * dx) / area
            share += _ring_share(u, v, rho, length, inner, s, bits, phase)
        geometry[SHARE, i], geometry[SLOPE, i] = share, slope


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def find_clipped(pixels, geometry, used, p, window, noise, by_value, clipped):
    """Return which pixels say only "at least" (or "at most"), and whether any do."""
    x0, y0, r0 = window.x0, window.y0, window.r0
    read, gain, saturation = noise.read, noise.gain, noise.saturation
    some = False
    for i in range(used):
        value, share = pixels[2, i], geometry[SHARE, i]
        tx, ty = (pixels[0, i] - x0) / r0, (pixels[1, i] - y0) / r0
        f = p[F0] + p[FX] * tx + p[FY] * ty
        b = p[B0] + p[BX] * tx + p[BY] * ty
        model = b + (f - b) * share
        sigma = math.sqrt(read + gain * max(model, 0.0))
        high = value > saturation - 4.5 * sigma
        clipped[i] = (model <= 0.0 and value <= 0.0) or (
            high and (by_value or model > saturation - 2.0 * sigma)
        )
        some = some or clipped[i]
    return some


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def linearise(pixels, geometry, used, p, window, noise, clipped, rows, rests, statistics):
    """Fill weighted derivatives (12, N) and residuals (N,), 0 where clipped, and statistics."""
    x0, y0, r0, read, gain = window.x0, window.y0, window.r0, noise.read, noise.gain
    x, y, xx, xy, yy = p[COL], p[ROW], p[XX], p[XY], p[YY]
    f0, fx, fy, b0, bx, by = p[F0], p[FX], p[FY], p[B0], p[BX], p[BY]
    per_s, per_r0 = 1.0 / p[BLUR], 1.0 / r0
    set_pixels = clear_pixels = set_squares = clear_squares = chi2 = 0.0
    for i in range(used):
        dx, dy = pixels[0, i] - x, pixels[1, i] - y
        tx, ty = (pixels[0, i] - x0) * per_r0, (pixels[1, i] - y0) * per_r0
        mx, my = xx * dx + xy * dy, xy * dx + yy * dy
        per_norm = geometry[LENGTH, i] / geometry[RHO, i]
        share = geometry[SHARE, i]
        f, b = f0 + fx * tx + fy * ty, b0 + bx * tx + by * ty
        model = b + (f - b) * share
        root = 1.0 / math.sqrt(read + gain * max(model, 0.0))
        counts = 0.0 if clipped[i] else 1.0
        root *= counts
        residual = counts * (pixels[2, i] - model)
        rest = root * residual
        chi2 += rest * rest
        square = residual * residual
        set_pixels += counts if share > 0.5 else 0.0
        set_squares += square if share > 0.5 else 0.0
        clear_pixels += 0.0 if share > 0.5 else counts
        clear_squares += 0.0 if share > 0.5 else square
        steep = (f - b) * geometry[SLOPE, i] * per_s * root
        bend = -0.5 * steep * per_norm
        on, off = root * share, root * (1.0 - share)
        rows[COL, i], rows[ROW, i] = steep * mx * per_norm, steep * my * per_norm
        rows[XX, i], rows[XY, i], rows[YY, i] = bend * dx * dx, 2.0 * bend * dx * dy, bend * dy * dy
        rows[BLUR, i] = steep * geometry[DISTANCE, i] * per_s
        rows[F0, i], rows[FX, i], rows[FY, i] = on, on * tx, on * ty
        rows[B0, i], rows[BX, i], rows[BY, i] = off, off * tx, off * ty
        rests[i] = rest
    statistics[SET_PIXELS], statistics[SET_SQUARES] = set_pixels, set_squares
    statistics[CLEAR_PIXELS], statistics[CLEAR_SQUARES] = clear_pixels, clear_squares
    statistics[CHI2], statistics[PIXELS] = chi2, set_pixels + clear_pixels
