"""Targets on which the light falls off: a reflector's beam ends there, or a shadow begins.

A retroreflective target sends the light back to where it came from, so a lamp beside the lens
leaves one side of it darker. What light does not change is which side of an edge is brighter:

* the dot's edge lies where a ray from its inside falls most steeply *in proportion*;
* a sector is set where it is brighter, in proportion, than the gap before it and what lies
  behind it.

The sectors that are set tell the light all around the ring (`uneven_light`). With it the ring is
read, and doubted, as under even light (`reading.read_ring`).
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from omm_core.targets.coded.reading import (
    FACTS,
    NONE,
    PHASE,
    SAMPLES,
    doubt,
    read_bits,
    read_ring,
    ring_profile,
)
from omm_core.targets.coded.uneven_light import light_around_ring
from omm_core.targets.conic.outline import (
    MIN_RADIUS_PX,
    between,
    fit_conic,
    inside,
    semi_axes,
    square_root,
)

FEW_RAYS, RAYS = 16, 48
MIN_FALL = 0.3
"""Difference by the darker side, over two steps along a ray, from which on there is an edge."""
MIN_SHARE = 0.87
"""Share of the rays that must meet the ellipse."""
MIN_RATIO = 1.6
"""Brighter by darker side, from which on a sector differs from what is around it."""
MAX_SIDES = 1.6
"""Largest ratio of the ring's brightness near its two edges (blur takes from both)."""
MIN_DN = 2.0
"""And by how many grey values of 8 bit."""


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
def _ellipse(points, levels, shape, turn):
    """Fit the ellipse to the points, without the few that are far from it; fill the shape."""
    # Mean and moments of the points are those of a circle stretched to about the ellipse.
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
        return False
    f11, f12, f22 = square_root(yy / det, -xy / det, xx / det)
    area = f11 * f22 - f12 * f12
    unit_points = np.empty((rays, 2))
    used = np.ones(rays, dtype=np.bool_)
    p = np.empty(5)
    off = 0.0
    for again in range(2):
        count = 0
        for i in range(rays):
            if used[i]:
                x, y = points[i, 0] - mx, points[i, 1] - my
                unit_points[count, 0] = (f22 * x - f12 * y) / area
                unit_points[count, 1] = (f11 * y - f12 * x) / area
                count += 1
        if count < MIN_SHARE * rays or not fit_conic(unit_points, count, p):
            return False
        det = p[0] * p[2] - p[1] * p[1]
        if not det > 0.05:
            return False
        du = -0.5 * (p[2] * p[3] - p[1] * p[4]) / det
        dv = -0.5 * (p[0] * p[4] - p[1] * p[3]) / det
        scale = 1.0 + p[0] * du * du + 2.0 * p[1] * du * dv + p[2] * dv * dv
        if not (scale > 0.0 and du * du + dv * dv < 0.25):
            return False
        limit = max(0.5, 0.08 * math.sqrt(area)) * (2.0 if turn == 0 else 1.0)
        off = 0.0
        for i in range(rays):
            x, y = points[i, 0] - mx, points[i, 1] - my
            u, v = (f22 * x - f12 * y) / area - du, (f11 * y - f12 * x) / area - dv
            rho = math.sqrt(max(p[0] * u * u + 2.0 * p[1] * u * v + p[2] * v * v, 1e-9) / scale)
            x, y = f11 * u + f12 * v, f12 * u + f22 * v
            away = abs(1.0 - 1.0 / rho) * math.sqrt(x * x + y * y)
            off += away * away / count if used[i] else 0.0
            if again == 0:
                used[i] = away < limit
    q11, q12, q22 = p[0] / scale, p[1] / scale, p[2] / scale
    i11, i12, i22 = f22 / area, -f12 / area, f11 / area
    b11, b12 = i11 * q11 + i12 * q12, i11 * q12 + i12 * q22
    b21, b22 = i12 * q11 + i22 * q12, i12 * q12 + i22 * q22
    shape[0] += mx + f11 * du + f12 * dv
    shape[1] += my + f12 * du + f22 * dv
    shape[2], shape[3], shape[4] = (
        b11 * i11 + b12 * i12,
        b11 * i12 + b12 * i22,
        b21 * i12 + b22 * i22,
    )
    shape[5] = shape[6] = shape[8] = 0.0
    for i in range(rays):
        shape[5] += levels[i, 0] / rays
        shape[6] += levels[i, 1] / rays
        step = abs(levels[i, 0] - levels[i, 1])
        shape[8] += step / (2.5066 * max(levels[i, 2], 1e-9)) / rays
    shape[7] = math.sqrt(off)
    return True


@numba.njit(cache=True, error_model="numpy")
def read_uneven(image, shape, sign, unit, ring, bits_count, light):
    """Read a ring under light that falls across it.

    Parameters
    ----------
    shape : (9,) from `outline_uneven`. ring : (2,) its radii (dot radii). unit : as there.
    light : (2, n SAMPLES) out: what is clear and the difference of set and clear around the ring.

    Returns
    -------
    bits, facts : see `reading.read_ring`. ok : whether they can be trusted.
    """
    n = bits_count
    count = n * SAMPLES
    a11, a12, a22 = square_root(shape[2], shape[3], shape[4])
    middle, spread = 0.5 * (ring[0] + ring[1]), 0.25 * (ring[1] - ring[0])
    radii, at = np.empty(3), np.empty(1)
    radii[0], radii[1], radii[2] = middle - spread, middle, middle + spread
    seen = ring_profile(image, shape[0], shape[1], a11, a12, a22, 0.0, 0.0, radii, count)
    at[0] = 1.0 + 0.5 * (ring[0] - 1.0)
    gap = ring_profile(image, shape[0], shape[1], a11, a12, a22, 0.0, 0.0, at, count)
    at[0] = ring[1] + 0.35
    behind = ring_profile(image, shape[0], shape[1], a11, a12, a22, 0.0, 0.0, at, count)
    at[0] = 0.65
    dot = ring_profile(image, shape[0], shape[1], a11, a12, a22, 0.0, 0.0, at, count)
    facts, bits = np.zeros(FACTS), np.zeros(n, dtype=np.int64)
    for i in range(count):
        if math.isnan(seen[i]) or math.isnan(behind[i]):
            facts[PHASE] = math.nan
            return bits, facts, False
    # Borders between sectors are as steep in the dark: it is the proportion that counts.
    proportion = np.empty(count)
    for i in range(count):
        proportion[i] = math.log(seen[i] + 2.0 * unit)
    _, phase = read_bits(proportion, n)
    floor = _around(gap, count)
    high, low = np.empty(n), np.empty(n)
    values = np.empty(n)
    chosen = np.zeros(n, dtype=np.bool_)
    for b in range(n):
        value = base = far = 0.0
        for k in range(SAMPLES // 4, SAMPLES - SAMPLES // 4):
            i = int(phase + b * SAMPLES + k + 0.001) % count
            value += seen[i] * 2.0 / SAMPLES
            base += floor[i] * 2.0 / SAMPLES
            far += behind[i] * 2.0 / SAMPLES
        values[b] = sign * (value - base)
        # A set sector differs from both of its sides, a clear one from neither.
        near = max(base, far) if sign > 0 else min(base, far)
        low[b], high[b] = (near, value) if sign > 0 else (value, near)
        chosen[b] = high[b] > MIN_RATIO * low[b] and high[b] - low[b] > MIN_DN * unit
    odd = 0
    for b in range(n):
        odd += 1 if chosen[b] else 0
    # All families' codes have an even number of bits.
    if odd % 2 == 1 or not _fills(image, shape, radii, floor, chosen, phase, sign):
        return bits, facts, False
    inner = np.empty(count)
    for i in range(count):
        inner[i] = sign * (dot[i] - floor[i])
    if not light_around_ring(values, chosen, phase, inner, unit, light[1]):
        return bits, facts, False
    for i in range(count):
        light[0, i], light[1, i] = floor[i], sign * light[1, i]
    bits, facts = read_ring(image, shape, np.zeros(2), light, ring[0], ring[1], n)
    if doubt(facts) != NONE:
        return bits, facts, False
    for b in range(n):
        if (bits[b] == 1) != chosen[b]:
            return bits, facts, False
    return bits, facts, True


@numba.njit(cache=True, error_model="numpy")
def _fills(image, shape, radii, floor, chosen, phase, sign):
    """Whether what is set is as bright near the ring's inner edge as near its outer one.

    Another family's ring, of which only a part lies here, is not.
    """
    count, n = len(floor), len(chosen)
    a11, a12, a22 = square_root(shape[2], shape[3], shape[4])
    sums = np.zeros(2)
    for side in range(2):
        at = radii[2 * side : 2 * side + 1].copy()
        seen = ring_profile(image, shape[0], shape[1], a11, a12, a22, 0.0, 0.0, at, count)
        for b in range(n):
            for k in range(SAMPLES // 4, SAMPLES - SAMPLES // 4):
                i = int(phase + b * SAMPLES + k + 0.001) % count
                sums[side] += sign * (seen[i] - floor[i]) if chosen[b] else 0.0
    return min(sums[0], sums[1]) * MAX_SIDES > max(sums[0], sums[1])


@numba.njit(cache=True, error_model="numpy")
def _around(profile, count):
    """Mean over one sector's width to each side."""
    smooth = np.empty(count)
    for i in range(count):
        total = 0.0
        for k in range(-SAMPLES, SAMPLES + 1):
            total += profile[(i + k) % count]
        smooth[i] = total / (2 * SAMPLES + 1)
    return smooth
