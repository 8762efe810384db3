"""The outline of a dot on which the light falls off.

What light does not change is which side of an edge is brighter: the dot's edge lies where a ray
from its inside falls most steeply *in proportion*.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from omm_core.targets.conic.outline import (
    COL,
    LEVEL_IN,
    LEVEL_OUT,
    MIN_RADIUS_PX,
    OFF,
    ROW,
    WIDTH,
    XX,
    XY,
    YY,
    between,
    centre_and_size,
    fit_conic,
    in_pixels,
    inside,
    semi_axes,
    square_root,
)

FEW_RAYS, RAYS = 16, 48
MIN_FALL = 0.3
"""Difference by the darker side, over two steps along a ray, from which on there is an edge."""
MIN_SHARE = 0.87
"""Share of the rays that must meet the ellipse."""


def grey_unit(image: NDArray[Any]) -> float:
    """Return what a grey value of 8 bit is in the image: sensors fill 16 bit differently."""
    return 1.0 if image.dtype == np.uint8 else max(float(image[::4, ::4].max()) / 255.0, 1.0)


@numba.njit(cache=True, error_model="numpy")
def outline_uneven(image, candidate, unit):
    """Outline of a dot on which the light may fall off steeply.

    Parameters
    ----------
    candidate : (6,) of the search; perhaps of a bright part of the dot only.
    unit : what a grey value of 8 bit is here.

    Returns
    -------
    shape : (9,) as from `outline.outline`. ok : False where it is not that of a dot.
    """
    shape = np.empty(9)
    shape[:5] = candidate[:5]
    points, levels = np.empty((RAYS, 2)), np.empty((RAYS, 4))
    for turn in range(2):
        # A first look with few rays finds where the dot is, and turns most that is none away.
        rays = FEW_RAYS if turn == 0 else RAYS
        if not _edges(image, shape, candidate[5], turn, unit, points[:rays], levels):
            return shape, False
        if not _ellipse(points[:rays], levels, shape, turn):
            return shape, False
    smaller, larger = semi_axes(shape[2], shape[3], shape[4])
    fits = shape[7] <= 0.15 + 0.04 * smaller
    return shape, fits and smaller >= MIN_RADIUS_PX and larger <= 3.0 * smaller


@numba.njit(cache=True, error_model="numpy")
def _edges(image, shape, sign, turn, unit, points, levels):
    """Places (px from the centre) and levels (inside, outside, slope) of the edge on all rays."""
    smaller, larger = semi_axes(shape[2], shape[3], shape[4])
    a11, a12, a22 = square_root(shape[2], shape[3], shape[4])
    rays = len(points)
    for k in range(rays):
        i = (7 * k) % rays  # far from each other, so that what is no dot shows at once
        angle = 2.0 * math.pi * i / rays
        c, s = math.cos(angle), math.sin(angle)
        step = max(0.5, 0.06 * smaller)
        first, last = max(0.5 * smaller, 1.0), 2.2 * larger + 2.0
        if turn > 0:
            x, y = a11 * c + a12 * s, a12 * c + a22 * s
            length = math.sqrt(x * x + y * y)
            c, s = x / length, y / length
            first, last = 0.55 * length, 1.45 * length
        t = _steepest(image, shape, sign, c, s, first, last, step, unit)
        if t < 0.0 or not _half_level(image, shape, sign, c, s, t, step, levels[i]):
            return False
        points[i, 0], points[i, 1] = levels[i, 3] * c, levels[i, 3] * s
    return True


@numba.njit(cache=True, error_model="numpy")
def _steepest(image, shape, sign, c, s, first, last, step, unit):
    """Where a ray falls most steeply in proportion, before the ring; negative where it does not."""
    best, best_t = MIN_FALL, -1.0
    col, row = shape[0], shape[1]
    t = first
    while t <= last:
        far = t + step
        if not inside(image, col + far * c, row + far * s):
            return -1.0
        before = between(image, col + (t - step) * c, row + (t - step) * s)
        after = between(image, col + far * c, row + far * s)
        fall = sign * (before - after) / (min(before, after) + 2.0 * unit)
        if fall > best:
            best, best_t = fall, t
        if best_t > 0.0 and fall < -0.5 * best:
            break  # the ring begins
        t += 0.5 * step
    return best_t


@numba.njit(cache=True, error_model="numpy")
def _half_level(image, shape, sign, c, s, t, step, level):
    """Fill (4,) level inside, level outside, slope, place of the half level near t."""
    col, row = shape[0], shape[1]
    begin, end = max(t - 3.0 * step, 0.0), t + 3.0 * step
    if not inside(image, col + end * c, row + end * s):
        return False
    level[0] = between(image, col + begin * c, row + begin * s)
    level[1] = between(image, col + end * c, row + end * s)
    half = 0.5 * (level[0] + level[1])
    before = sign * (level[0] - half)
    fine = 0.25 * step
    level[2], level[3] = 0.0, -1.0
    t = begin
    while t < end:
        now = sign * (between(image, col + (t + fine) * c, row + (t + fine) * s) - half)
        level[2] = max(level[2], (before - now) / fine)
        if level[3] < 0.0 and before > 0.0 >= now:
            level[3] = t + fine * before / (before - now)
        before = now
        t += fine
    return level[3] > 0.0


@numba.njit(cache=True, error_model="numpy")
def _round_about(points):
    """Return mean and root (see `square_root`) of the ellipse that has the points' moments.

    Those of a circle's edge, stretched to about the ellipse; ok is False where they are on a line.
    """
    rays = len(points)
    mx = my = xx = xy = yy = 0.0
    for i in range(rays):
        mx += points[i, 0] / rays
        my += points[i, 1] / rays
    for i in range(rays):
        x, y = points[i, 0] - mx, points[i, 1] - my
        xx += 2.0 * x * x / rays
        xy += 2.0 * x * y / rays
        yy += 2.0 * y * y / rays
    det = xx * yy - xy * xy
    if not det > 0.05 * xx * yy:
        return False, (0.0, 0.0), (0.0, 0.0, 0.0)
    return True, (mx, my), square_root(yy / det, -xy / det, xx / det)


@numba.njit(cache=True, error_model="numpy")
def _on_circle(points, used, middle, root, stretched):
    """Fill the points that are used, stretched to about the unit circle; return how many."""
    mx, my = middle
    f11, f12, f22 = root
    area = f11 * f22 - f12 * f12
    count = 0
    for i in range(len(points)):
        if used[i]:
            x, y = points[i, 0] - mx, points[i, 1] - my
            stretched[count, 0] = (f22 * x - f12 * y) / area
            stretched[count, 1] = (f11 * y - f12 * x) / area
            count += 1
    return count


@numba.njit(cache=True, error_model="numpy")
def _set_away(points, middle, root, p, centre, away):
    """Fill how far each point is off the conic `p` about `centre` (of the circle's frame), px."""
    mx, my = middle
    f11, f12, f22 = root
    du, dv, scale = centre
    area = f11 * f22 - f12 * f12
    for i in range(len(points)):
        x, y = points[i, 0] - mx, points[i, 1] - my
        u, v = (f22 * x - f12 * y) / area - du, (f11 * y - f12 * x) / area - dv
        rho = math.sqrt(max(p[0] * u * u + 2.0 * p[1] * u * v + p[2] * v * v, 1e-9) / scale)
        x, y = f11 * u + f12 * v, f12 * u + f22 * v
        away[i] = abs(1.0 - 1.0 / rho) * math.sqrt(x * x + y * y)


@numba.njit(cache=True, error_model="numpy")
def _set_edge(levels, rays, shape):
    """Fill the shape's levels inside and outside and its edge's width: the means of the rays'."""
    shape[LEVEL_IN] = shape[LEVEL_OUT] = shape[WIDTH] = 0.0
    for i in range(rays):
        shape[LEVEL_IN] += levels[i, 0] / rays
        shape[LEVEL_OUT] += levels[i, 1] / rays
        step = abs(levels[i, 0] - levels[i, 1])
        # A Gaussian edge of height h is h / (sqrt(2 pi) sigma) steep.
        shape[WIDTH] += step / (2.5066 * max(levels[i, 2], 1e-9)) / rays


@numba.njit(cache=True, error_model="numpy")
def _ellipse(points, levels, shape, turn):
    """Fit the ellipse to the points, without the few that are far from it; fill the shape."""
    rays = len(points)
    ok, middle, root = _round_about(points)
    if not ok:
        return False
    f11, f12, f22 = root
    limit = max(0.5, 0.08 * math.sqrt(f11 * f22 - f12 * f12)) * (2.0 if turn == 0 else 1.0)
    stretched, away = np.empty((rays, 2)), np.empty(rays)
    used = np.ones(rays, dtype=np.bool_)
    p = np.empty(5)
    off = du = dv = scale = 0.0
    for again in range(2):
        count = _on_circle(points, used, middle, root, stretched)
        if count < MIN_SHARE * rays or not fit_conic(stretched, count, p):
            return False
        ok, du, dv, scale = centre_and_size(p)
        if not ok:
            return False
        _set_away(points, middle, root, p, (du, dv, scale), away)
        off = 0.0
        for i in range(rays):
            off += away[i] * away[i] / count if used[i] else 0.0
            if again == 0:
                used[i] = away[i] < limit
    shape[COL] += middle[0] + f11 * du + f12 * dv
    shape[ROW] += middle[1] + f12 * du + f22 * dv
    shape[XX], shape[XY], shape[YY] = in_pixels(p, scale, root)
    shape[OFF] = math.sqrt(off)
    _set_edge(levels, rays, shape)
    return True
