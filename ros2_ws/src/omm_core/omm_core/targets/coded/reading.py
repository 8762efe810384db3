"""The bits of the ring around a dot, and all that speaks against them."""

from __future__ import annotations

import math

import numba
import numpy as np

from omm_core.targets.coded.ring_facts import (
    BEFORE,
    FACTS,
    GAP,
    LARGEST,
    MARGIN,
    MAX_PROFILE_RMS,
    MAX_SECTOR_ERROR,
    MIN_MARGIN,
    NO_DOT,
    NONE,
    PHASE,
    PROFILE_RMS,
    SECTOR_ERROR,
    STANDS_OUT,
    doubt,
)
from omm_core.targets.coded.ring_profile import SAMPLES, View, expected_of, profile_of, read_bits
from omm_core.targets.conic.outline import (
    COL,
    LEVEL_IN,
    LEVEL_OUT,
    ROW,
    WIDTH,
    XX,
    XY,
    YY,
    dot_outline,
    square_root,
    within_any,
)

MAX_BY_GAP, MAX_BY_BEHIND, MAX_BY_BEHIND_IN_SHADOW = 2.0, 1.5, 1.2
"""How much brighter than the gap before it and than what is behind it a clear sector may be; than
the latter less where the dot's side is dark, too."""


@numba.njit(cache=True, error_model="numpy")
def _set_bits(view, values, radii, bits, facts):
    """Fill the bits from the sectors' means, with margin and largest value."""
    bits[:] = 1
    places = np.int64(16)
    all_set = expected_of(view, bits, 0.0, radii, places)
    level = 0.0
    for i in range(places):
        level += all_set[i] / places
    facts[MARGIN] = math.inf
    for b in range(len(bits)):
        value = values[b] / level
        facts[LARGEST] = max(facts[LARGEST], value) if b > 0 else value
        facts[MARGIN] = min(facts[MARGIN], abs(value - 0.5))
        bits[b] = 1 if value > 0.5 else 0


@numba.njit(cache=True, error_model="numpy")
def _set_errors(view, ring, phase, radii, bits, facts):
    """Fill how far the profile is from what the bits predict, and return it."""
    count = len(ring)
    error = expected_of(view, bits, facts[PHASE], radii, count)
    for i in range(count):
        error[i] = ring[i] - error[i]
        facts[PROFILE_RMS] += error[i] * error[i] / count
    facts[PROFILE_RMS] = math.sqrt(facts[PROFILE_RMS])
    start = int(phase + 0.5)
    for b in range(len(bits)):
        total = 0.0
        for k in range(SAMPLES):
            total += error[(start + b * SAMPLES + k) % count] / SAMPLES
        facts[SECTOR_ERROR] = max(facts[SECTOR_ERROR], abs(total))
    return error


@numba.njit(cache=True, error_model="numpy")
def _set_beside(image, view, wider, light, phase, bits, facts):
    """Fill what is still set before and beyond the ring; return what lies behind it.

    Beyond the ring two places are looked at: what is bright around a label may reach the outer.
    """
    bases, heights = light
    n, count = len(bits), len(bases) // 2
    at = np.empty(1)
    still = np.zeros((2, count))
    still[:] = math.inf
    seen = np.empty(0)
    for place in range(3):
        before = view.inner - 0.3 - wider
        at[0] = before if place == 0 else view.outer + (0.2 if place == 1 else 0.35)
        seen = profile_of(image, view, at, count)
        expected = expected_of(view, bits, facts[PHASE], at, count)
        side = min(place, 1)
        for i in range(count):
            if not math.isnan(seen[i]):
                rest = (seen[i] - bases[2 * i]) / heights[2 * i] - expected[i]
                still[side, i] = min(still[side, i], rest)
    for side in range(2):
        on = total = 0.0
        for i in range(count):
            sector = math.floor((2 * i + 1 - phase) / SAMPLES) % n
            if bits[sector] == 1 and still[side, i] < math.inf:
                total += 1.0
                on += still[side, i] > 0.4
        facts[BEFORE + side] = on / total if total > 0.0 else 0.0
    return seen


@numba.njit(cache=True, error_model="numpy")
def _look_beside(image, view, levels, ring, error, light, phase, bits, facts):
    """Fill what gap, dot, and the places before and beyond the ring say against it."""
    bases, heights = light
    dot_level, height = levels[0], levels[0] - levels[1]
    count = len(ring) // 2
    at = np.empty(1)
    at[0] = 1.0 + 0.5 * (view.inner - 1.0)
    gap = profile_of(image, view, at, count)
    for i in range(count):
        facts[GAP] = max(facts[GAP], abs(gap[i] - bases[2 * i]) / heights[2 * i])
    # Where the dot is saturated, all that is bright looks wider, by up to about s.
    highest = 254.5 if image.itemsize == 1 else 65534.5
    area = view.a11 * view.a22 - view.a12 * view.a12
    wider = view.s / math.sqrt(area) if not 0.5 < dot_level < highest else 0.0
    behind = _set_beside(image, view, wider, light, phase, bits, facts)
    # What blur brings over from set sectors, of which a saturated one is brighter than it looks.
    over = 2.0 if wider > 0.0 else 1.0
    for i in range(2 * count):
        ring[i] = bases[i] + heights[i] * (ring[i] - over * (ring[i] - error[i]))
    at[0] = 0.65
    dot = profile_of(image, view, at, count)
    for i in range(count):
        dot[i] = (dot[i] - gap[i]) / height
    facts[STANDS_OUT] = _shaded(ring, gap, behind, dot, bits, phase, 1 if height > 0.0 else -1)


@numba.njit(cache=True, error_model="numpy")
def read_ring(image, shape, lean, light, inner, outer, bits_count):
    """Read the ring around a dot and everything that speaks for or against it.

    Parameters
    ----------
    shape : (9,) from `outline`.
    lean : (2,) the perspective's share, see `ring_profile`.
    light : (2, n SAMPLES) what is clear, and the difference of set and clear, around the ring, see
        `uneven`; (2, 0) where light does not fall.

    Returns
    -------
    bits : (n,) 0/1, clockwise from the phase.
    facts : (FACTS,) PHASE (rad), NaN where the image's border cuts the ring; MARGIN of the most
        doubtful sector; SECTOR_ERROR and PROFILE_RMS, the largest error of a sector's mean and the
        RMS error of the profile against what the bits predict; GAP, the largest deviation there;
        BEFORE and BEYOND, shares of set samples that are still set before the ring and beyond it;
        LARGEST value of a sector; STANDS_OUT, by how much more than noise may do a clear sector
        stands out of its sides.
    """
    bits = np.zeros(bits_count, dtype=np.int64)
    facts = np.zeros(FACTS)
    count = bits_count * SAMPLES
    a11, a12, a22 = square_root(shape[XX], shape[XY], shape[YY])
    base, height = shape[LEVEL_OUT], shape[LEVEL_IN] - shape[LEVEL_OUT]
    s = max(shape[WIDTH], 0.4)
    view = View(shape[COL], shape[ROW], a11, a12, a22, lean[0], lean[1], inner, outer, s)
    middle, spread = 0.5 * (inner + outer), 0.25 * (outer - inner)
    radii = np.empty(3)
    radii[0], radii[1], radii[2] = middle - spread, middle, middle + spread
    ring = profile_of(image, view, radii, count)
    for i in range(count):
        if math.isnan(ring[i]):
            facts[PHASE] = math.nan
            return bits, facts
    bases, heights = np.full(count, base), np.full(count, height)
    for i in range(light.shape[1]):
        bases[i], heights[i] = light[0, i], light[1, i]
    for i in range(count):
        ring[i] = (ring[i] - bases[i]) / heights[i]
    values, phase = read_bits(ring, bits_count)
    _set_bits(view, values, radii, bits, facts)
    facts[PHASE] = phase * 2.0 * math.pi / count
    if facts[LARGEST] < 0.5 or facts[MARGIN] < 0.1:
        facts[PROFILE_RMS] = 1.0 if facts[MARGIN] >= 0.1 else 0.0
        return bits, facts
    error = _set_errors(view, ring, phase, radii, bits, facts)
    off = facts[SECTOR_ERROR] > MAX_SECTOR_ERROR or facts[PROFILE_RMS] > MAX_PROFILE_RMS
    if facts[MARGIN] < MIN_MARGIN or off:
        return bits, facts  # refused anyway
    levels = (shape[LEVEL_IN], shape[LEVEL_OUT])
    _look_beside(image, view, levels, ring, error, (bases, heights), phase, bits, facts)
    return bits, facts


@numba.njit(cache=True, error_model="numpy")
def _shaded(ring, gap, behind, dot, bits, phase, sign):
    """How far a clear sector stands out of what is before and behind it, by what noise may do.

    A set sector in the shadow is darker than half, but brighter than the label beside it.
    """
    count, n = len(gap), len(bits)
    steps = 0.0
    for i in range(count):
        steps += abs(gap[i] - gap[i - 1]) / count
    # Noise lets neighbouring samples differ by 1.1 of its standard deviation.
    allowed = max(4.0 * steps, 2.0)
    most = 0.0
    for b in range(n):
        if bits[b] == 1:
            continue
        value = near = far = inside = 0.0
        taken = 0
        for k in range(SAMPLES // 4, SAMPLES - SAMPLES // 4):
            i = int(phase + b * SAMPLES + k + 0.001) % (2 * count)
            value += ring[i]
            near += gap[i // 2]
            far += behind[i // 2]
            inside += dot[i // 2]
            taken += 1
        if math.isnan(far):
            far = near
        ratio = MAX_BY_BEHIND_IN_SHADOW if inside < 0.7 * taken else MAX_BY_BEHIND
        if sign > 0:
            out = value > MAX_BY_GAP * near and value > ratio * far
        else:
            out = near > MAX_BY_GAP * value and far > ratio * value
        if out:
            most = max(most, abs(value - near) / taken / allowed)
    return most


@numba.njit(cache=True, error_model="numpy")
def read_candidates(image, candidates, inner, outer, bits_count):
    """Return outline and ring of all candidates, ignoring perspective.

    Parameters
    ----------
    candidates : (N, 6), large ones first: the sectors of a ring look like small dots, and need no
        second look.

    Returns
    -------
    dots : (M,) which of the candidates lie in no other's ring. shapes (M, 9), bits (M, n),
    facts (M, FACTS), against (M,) : see `outline`, `read_ring` and `doubt`; of NO_DOT the
    candidate's ellipse is all there is of the shape.
    """
    n = len(candidates)
    dots = np.empty(n, dtype=np.int64)
    shapes, facts = np.zeros((n, 9)), np.zeros((n, FACTS))
    bits = np.zeros((n, bits_count), dtype=np.int64)
    against = np.empty(n, dtype=np.int64)
    rings = np.empty((n, 5))
    count = good = np.int64(0)
    straight, even = np.zeros(2), np.empty((2, 0))
    for i in range(n):
        if within_any(rings, good, candidates[i, 0], candidates[i, 1], outer):
            continue
        shape, ok = dot_outline(image, candidates[i])
        dots[count] = i
        if not ok:
            against[count] = NO_DOT
            for k in range(5):
                shapes[count, k] = candidates[i, k]
            count += 1
            continue
        ring_bits, ring_facts = read_ring(image, shape, straight, even, inner, outer, bits_count)
        for k in range(9):
            shapes[count, k] = shape[k]
        for k in range(FACTS):
            facts[count, k] = ring_facts[k]
        for k in range(bits_count):
            bits[count, k] = ring_bits[k]
        against[count] = doubt(ring_facts)
        if against[count] == NONE:
            for k in range(5):
                rings[good, k] = shape[k]
            good += 1
        count += 1
    return dots[:count], shapes[:count], bits[:count], facts[:count], against[:count]
