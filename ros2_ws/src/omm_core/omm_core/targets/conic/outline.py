"""The dot's outline at full size: an ellipse through the half levels of its edge."""

from __future__ import annotations

import math

import numba
import numpy as np

from omm_core.numerics.linear_algebra import solve_damped

OUTLINE_RAYS = 48
COL, ROW, XX, XY, YY, LEVEL_IN, LEVEL_OUT, OFF, WIDTH = range(9)
"""What `outline` returns at each place; a conic is the first five."""
MIN_RADIUS_PX = 1.8
"""Smaller semi-axis from which on a ring can be read."""


@numba.njit(cache=True, error_model="numpy")
def between(image, col, row):
    """Return the bilinear grey value; the place must be inside the image (see `inside`)."""
    x, y = int(col), int(row)
    fx, fy = col - x, row - y
    top = image[y, x] + fx * (np.int64(image[y, x + 1]) - np.int64(image[y, x]))
    bottom = image[y + 1, x] + fx * (np.int64(image[y + 1, x + 1]) - np.int64(image[y + 1, x]))
    return top + fy * (bottom - top)


@numba.njit(cache=True, error_model="numpy")
def inside(image, col, row):
    """Return whether a place has four pixels around it."""
    height, width = image.shape
    return 0.0 <= col <= width - 1.001 and 0.0 <= row <= height - 1.001


@numba.njit(cache=True, error_model="numpy")
def within_any(conics, count, col, row, ratio):
    """Return whether a point lies within `ratio` times one of the first `count` ellipses (N, 5)."""
    for i in range(count):
        dx, dy = col - conics[i, 0], row - conics[i, 1]
        rho2 = conics[i, 2] * dx * dx + 2.0 * conics[i, 3] * dx * dy + conics[i, 4] * dy * dy
        if rho2 < ratio * ratio:
            return True
    return False


@numba.njit(cache=True, error_model="numpy")
def square_root(xx, xy, yy):
    """Return a with A A = M⁻¹ (symmetric): maps the unit circle to the ellipse xᵀ M x = 1."""
    det = xx * yy - xy * xy
    ixx, ixy, iyy = yy / det, -xy / det, xx / det
    s = math.sqrt(ixx * iyy - ixy * ixy)
    t = math.sqrt(ixx + iyy + 2.0 * s)
    return (ixx + s) / t, ixy / t, (iyy + s) / t


@numba.njit(cache=True, error_model="numpy")
def semi_axes(xx, xy, yy):
    """Return the smaller and larger semi-axis of the ellipse xᵀ M x = 1."""
    a11, a12, a22 = square_root(xx, xy, yy)
    mean, half = 0.5 * (a11 + a22), 0.5 * math.sqrt((a11 - a22) ** 2 + 4.0 * a12 * a12)
    return mean - half, mean + half


@numba.njit(cache=True, error_model="numpy")
def _edge_on_ray(image, col, row, ux, uy, sign, begin, end):
    """Return where a ray from a dot's centre along (ux, uy) crosses the half level of its edge.

    Returns
    -------
    found, at : whether it does between `begin` and `end` (of the ray's vector), and where.
    v_in, v_out : grey values inside and outside. width : of the edge (standard deviation, px).
    """
    length = math.sqrt(ux * ux + uy * uy)
    # The last sample of a short ray lies farther out than 1.5 of it.
    step = max(0.5 / max(length, 1.0), 1.0 / 32.0)
    far = max(1.5, end + step)
    if not inside(image, col + far * ux, row + far * uy):
        return False, 0.0, 0.0, 0.0, 0.0
    v_in = 0.5 * (
        between(image, col + 0.5 * ux, row + 0.5 * uy)
        + between(image, col + 0.3 * ux, row + 0.3 * uy)
    )
    v_out = between(image, col + 1.5 * ux, row + 1.5 * uy)
    if not sign * (v_in - v_out) > 0.0:
        return False, 0.0, 0.0, 0.0, 0.0
    level = 0.5 * (v_in + v_out)
    t, at = begin, 0.0
    before = sign * (between(image, col + t * ux, row + t * uy) - level)
    found = False
    steepest = 0.0
    while t < end:
        now = sign * (between(image, col + (t + step) * ux, row + (t + step) * uy) - level)
        steepest = max(steepest, before - now)
        if not found and before > 0.0 and now <= 0.0:
            found = True
            at = t + step * before / (before - now)
        before = now
        t += step
    # A Gaussian edge of height h is h / (sqrt(2 pi) sigma) steep.
    slope = steepest / (step * length)
    return found, at, v_in, v_out, abs(v_in - v_out) / (2.5066 * max(slope, 1e-9))


@numba.njit(cache=True, error_model="numpy")
def centre_and_size(p):
    """Return whether a conic (see `fit_conic`) is an ellipse near the unit circle.

    With its centre, and what to divide its matrix by.
    """
    det = p[0] * p[2] - p[1] * p[1]
    if not det > 0.05:
        return False, 0.0, 0.0, 0.0
    du = -0.5 * (p[2] * p[3] - p[1] * p[4]) / det
    dv = -0.5 * (p[0] * p[4] - p[1] * p[3]) / det
    scale = 1.0 + p[0] * du * du + 2 * p[1] * du * dv + p[2] * dv * dv
    return scale > 0.0 and du * du + dv * dv < 0.25, du, dv, scale


@numba.njit(cache=True, error_model="numpy")
def _mean_square_off(points, rays, p, centre, root):
    """Return how far edge points are off the ellipse, the mean of the squares in px²."""
    du, dv, scale = centre
    a11, a12, a22 = root
    off = 0.0
    for i in range(rays):
        u, v = points[i, 0] - du, points[i, 1] - dv
        rho = math.sqrt(max(p[0] * u * u + 2 * p[1] * u * v + p[2] * v * v, 1e-9) / scale)
        ux, uy = a11 * u + a12 * v, a12 * u + a22 * v
        off += (1.0 - 1.0 / rho) ** 2 * (ux * ux + uy * uy) / rays
    return off


@numba.njit(cache=True, error_model="numpy")
def in_pixels(p, scale, root):
    """Return xx, xy, yy of a conic that is given in the frame of the unit circle."""
    a11, a12, a22 = root
    d = a11 * a22 - a12 * a12
    i11, i12, i22 = a22 / d, -a12 / d, a11 / d
    q11, q12, q22 = p[0] / scale, p[1] / scale, p[2] / scale
    b11, b12 = i11 * q11 + i12 * q12, i11 * q12 + i12 * q22
    b21, b22 = i12 * q11 + i22 * q12, i12 * q12 + i22 * q22
    return b11 * i11 + b12 * i12, b11 * i12 + b12 * i22, b21 * i12 + b22 * i22


@numba.njit(cache=True, error_model="numpy")
def outline(image, col, row, xx, xy, yy, sign):
    """Return the ellipse through the half levels of the dot's edge on rays from its centre.

    Returns
    -------
    result : (9,) col, row, the conic's xx, xy, yy, level inside, level outside, RMS of the edge
        points off the ellipse (px), width of the edge (standard deviation, px).
    ok : False where the edge is not found all around.
    """
    result = np.empty(9)
    points, p = np.empty((OUTLINE_RAYS, 2)), np.empty(5)
    for turn in range(2):
        # A first look with few rays turns most of what is no dot away.
        rays = OUTLINE_RAYS // 4 if turn == 0 else OUTLINE_RAYS
        begin, end = (0.5, 1.5) if turn == 0 else (0.65, 1.4)
        root = square_root(xx, xy, yy)
        a11, a12, a22 = root
        level_in = level_out = width = 0.0
        for i in range(rays):
            angle = 2 * math.pi * i / rays
            c, s = math.cos(angle), math.sin(angle)
            ux, uy = a11 * c + a12 * s, a12 * c + a22 * s
            found, at, v_in, v_out, wide = _edge_on_ray(image, col, row, ux, uy, sign, begin, end)
            if not found:
                return result, False
            points[i, 0], points[i, 1] = at * c, at * s
            level_in += v_in / rays
            level_out += v_out / rays
            width += wide / rays
        if not fit_conic(points, rays, p):
            return result, False
        ok, du, dv, scale = centre_and_size(p)
        if not ok:
            return result, False
        off = _mean_square_off(points, rays, p, (du, dv, scale), root)
        if turn == 0 and off > 0.25 + 0.0064 * (a11 * a22 - a12 * a12):
            return result, False
        xx, xy, yy = in_pixels(p, scale, root)
        col += a11 * du + a12 * dv
        row += a12 * du + a22 * dv
        result[COL], result[ROW], result[XX], result[XY], result[YY] = col, row, xx, xy, yy
        result[LEVEL_IN], result[LEVEL_OUT] = level_in, level_out
        result[OFF], result[WIDTH] = math.sqrt(off), width
    return result, True


@numba.njit(cache=True, error_model="numpy")
def dot_outline(image, candidate):
    """Return a candidate's (6,) `outline`, and whether it is that of a readable dot."""
    shape, ok = outline(
        image,
        candidate[0],
        candidate[1],
        candidate[2],
        candidate[3],
        candidate[4],
        int(candidate[5]),
    )
    if not ok:
        return shape, False
    smaller, larger = semi_axes(shape[XX], shape[XY], shape[YY])
    ok = (
        smaller >= MIN_RADIUS_PX and larger <= 3.0 * smaller and shape[OFF] <= 0.15 + 0.04 * smaller
    )
    return shape, ok


@numba.njit(cache=True, error_model="numpy")
def fit_conic(points, count, conic):
    """Fill (a, b, c, d, e) of a u² + 2 b u v + c v² + d u + e v = 1, by least squares.

    The points lie near the unit circle. Return False where they do not fix the conic.
    """
    normal = np.zeros((5, 5))
    right = np.zeros(5)
    g = np.empty(5)
    for i in range(count):
        u, v = points[i, 0], points[i, 1]
        g[0], g[1], g[2], g[3], g[4] = u * u, 2 * u * v, v * v, u, v
        for j in range(5):
            right[j] -= g[j]
            for k in range(5):
                normal[j, k] += g[j] * g[k]
    return solve_damped(normal, right, normal.shape[0], 0.0, np.empty((5, 5)), conic)
