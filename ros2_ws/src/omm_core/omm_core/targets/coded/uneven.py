"""Targets on which the light falls off: a reflector's beam ends there, or a shadow begins.

A retroreflective target sends the light back to where it came from, so a lamp beside the lens
leaves one side of it darker. What light does not change is which side of an edge is brighter: a
sector is set where it is brighter, in proportion, than the gap before it and what lies behind it.
(Of the dot's edge the same holds along a ray, see `uneven_outline`.)

The sectors that are set tell the light all around the ring (`uneven_light`). With it the ring is
read, and doubted, as under even light (`reading.read_ring`).
"""

from __future__ import annotations

import math

import numba
import numpy as np

from omm_core.targets.coded.reading import read_ring
from omm_core.targets.coded.ring_facts import FACTS, NONE, PHASE, doubt
from omm_core.targets.coded.ring_profile import SAMPLES, read_bits, ring_profile
from omm_core.targets.coded.uneven_light import light_around_ring
from omm_core.targets.conic.outline import square_root

MIN_RATIO = 1.6
"""Brighter by darker side, from which on a sector differs from what is around it."""
MAX_SIDES = 1.6
"""Largest ratio of the ring's brightness near its two edges (blur takes from both)."""
MIN_DN = 2.0
"""And by how many grey values of 8 bit."""


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
    facts, bits = np.zeros(FACTS), np.zeros(n, dtype=np.int64)
    middle, spread = 0.5 * (ring[0] + ring[1]), 0.25 * (ring[1] - ring[0])
    radii = np.empty(3)
    radii[0], radii[1], radii[2] = middle - spread, middle, middle + spread
    seen = _seen_at(image, shape, radii, count)
    behind = _seen_at(image, shape, np.full(1, ring[1] + 0.35), count)
    # Borders between sectors are as steep in the dark: it is the proportion that counts.
    proportion = np.empty(count)
    for i in range(count):
        if math.isnan(seen[i]) or math.isnan(behind[i]):
            facts[PHASE] = math.nan
            return bits, facts, False
        proportion[i] = math.log(seen[i] + 2.0 * unit)
    _, phase = read_bits(proportion, n)
    floor = _around(_seen_at(image, shape, np.full(1, 1.0 + 0.5 * (ring[0] - 1.0)), count), count)
    values, chosen = np.empty(n), np.zeros(n, dtype=np.bool_)
    odd = _choose_sectors(seen, floor, behind, phase, sign, unit, values, chosen) % 2
    # All families' codes have an even number of bits.
    if odd == 1 or not _fills(image, shape, radii, floor, chosen, phase, sign):
        return bits, facts, False
    dot = _seen_at(image, shape, np.full(1, 0.65), count)
    for i in range(count):
        dot[i] = sign * (dot[i] - floor[i])
    if not light_around_ring(values, chosen, phase, dot, unit, light[1]):
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
def _seen_at(image, shape, radii, count):
    """Return the profile at radii (in dot radii) around the shape, without perspective."""
    a11, a12, a22 = square_root(shape[2], shape[3], shape[4])
    return ring_profile(image, shape[0], shape[1], a11, a12, a22, 0.0, 0.0, radii, count)


@numba.njit(cache=True, error_model="numpy")
def _choose_sectors(seen, floor, behind, phase, sign, unit, values, chosen):
    """Fill how far each sector stands out of the floor, and which are set; return how many are.

    A set sector differs from both of its sides (the gap before it and what lies behind), a clear
    one from neither.
    """
    count = len(seen)
    sectors = 0
    for b in range(len(chosen)):
        value = base = far = 0.0
        for k in range(SAMPLES // 4, SAMPLES - SAMPLES // 4):
            i = int(phase + b * SAMPLES + k + 0.001) % count
            value += seen[i] * 2.0 / SAMPLES
            base += floor[i] * 2.0 / SAMPLES
            far += behind[i] * 2.0 / SAMPLES
        values[b] = sign * (value - base)
        near = max(base, far) if sign > 0 else min(base, far)
        low, high = (near, value) if sign > 0 else (value, near)
        chosen[b] = high > MIN_RATIO * low and high - low > MIN_DN * unit
        sectors += 1 if chosen[b] else 0
    return sectors


@numba.njit(cache=True, error_model="numpy")
def _fills(image, shape, radii, floor, chosen, phase, sign):
    """Whether what is set is as bright near the ring's inner edge as near its outer one.

    Another family's ring, of which only a part lies here, is not.
    """
    count, n = len(floor), len(chosen)
    sums = np.zeros(2)
    for side in range(2):
        seen = _seen_at(image, shape, radii[2 * side : 2 * side + 1].copy(), count)
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
