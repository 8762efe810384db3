"""The bits of the ring around a dot, and all that speaks against them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from omm_core.targets.conic.outline import (
    COL,
    LEVEL_IN,
    LEVEL_OUT,
    ROW,
    WIDTH,
    XX,
    XY,
    YY,
    between,
    dot_outline,
    inside,
    square_root,
    within_any,
)

FACTS = 9
PHASE, MARGIN, SECTOR_ERROR, PROFILE_RMS, GAP, BEFORE, BEYOND, LARGEST, STANDS_OUT = range(FACTS)
"""Places of the facts of `read_ring`."""
SAMPLES = 8
"""Samples of the ring per sector."""
MAX_GAP = 0.45
"""Largest deviation from the background between dot and ring."""
MAX_BESIDE = 0.35
"""Largest share of the set samples that is still set where the ring must have ended."""
MIN_MARGIN = 0.15
"""A sector nearer to the threshold (of a contrast of 1) is doubtful."""
MAX_SECTOR_ERROR = 0.28
"""How far a sector may be off what dot, blur and bits let expect."""
MAX_PROFILE_RMS = 0.17
"""The same for the root mean square around the ring."""
MAX_BY_GAP, MAX_BY_BEHIND, MAX_BY_BEHIND_IN_SHADOW = 2.0, 1.5, 1.2
"""How much brighter than the gap before it and than what is behind it a clear sector may be; than
the latter less where the dot's side is dark, too."""


@numba.njit(cache=True, error_model="numpy")
def ring_profile(image, col, row, a11, a12, a22, lean_x, lean_y, radii, count):
    """Return the mean grey value at radii (in dot radii), `count` angles clockwise.

    It is NaN outside the image.

    `lean` is the perspective's share: a point u of the target's plane (dot radii) is seen at
    centre + A u / (1 + lean · u).
    """
    profile = np.zeros(count)
    turn_c, turn_s = math.cos(2 * math.pi / count), math.sin(2 * math.pi / count)
    c, s = math.cos(math.pi / count), -math.sin(math.pi / count)
    for i in range(count):
        c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
        for j in range(len(radii)):
            r = radii[j]
            w = 1.0 + r * (lean_x * c + lean_y * s)
            x = (a11 * c + a12 * s) * r / w
            y = (a12 * c + a22 * s) * r / w
            if not inside(image, col + x, row + y):
                profile[i] = math.nan
                break
            profile[i] += between(image, col + x, row + y) / len(radii)
    return profile


@numba.njit(cache=True, error_model="numpy")
def read_bits(profile, bits):
    """Return the phase of the sectors and the mean over each one's middle half.

    Parameters
    ----------
    profile : (bits * SAMPLES,) 0 = background, 1 = set.

    Returns
    -------
    values : (bits,) clockwise. phase : where the first sector begins, in samples.
    """
    n = len(profile)
    re = im = 0.0
    for i in range(n):
        jump = abs(profile[(i + 1) % n] - profile[i - 1])
        angle = 2 * math.pi * (i + 0.5) / SAMPLES
        re += jump * jump * math.cos(angle)
        im += jump * jump * math.sin(angle)
    phase = math.atan2(im, re) / (2 * math.pi) * SAMPLES
    if phase < 0.0:
        phase += SAMPLES
    values = np.zeros(bits)
    for b in range(bits):
        total = 0.0
        taken = 0
        for k in range(SAMPLES // 4, SAMPLES - SAMPLES // 4):
            total += profile[int(phase + b * SAMPLES + k + 0.001) % n]
            taken += 1
        values[b] = total / taken
    return values, phase


_PHI = np.array([0.5 * math.erfc(-z / math.sqrt(2.0)) for z in np.arange(-256, 258) / 64.0])


@numba.njit(cache=True, error_model="numpy")
def phi(z):
    """Return the normal distribution to 1e-5, from a table."""
    if z >= 4.0:
        return 1.0
    if z <= -4.0:
        return 0.0
    t = 64.0 * z + 256.0
    i = int(t)
    return _PHI[i] + (t - i) * (_PHI[i + 1] - _PHI[i])


@numba.njit(cache=True, error_model="numpy")
def expected_profile(a11, a12, a22, inner, outer, bits, phase, s, radii, count):
    """Return what `ring_profile` should show of the bits: 0 to 1, with the blur s (px).

    `phase` is where the first sector begins (rad, clockwise; within the first sector's width).
    """
    n = len(bits)
    pitch = 2.0 * math.pi / n
    det = a11 * a22 - a12 * a12
    # Around the ring and on, so that no index needs to be wrapped.
    around = np.empty(n + 6, dtype=np.int64)
    for m in range(n + 6):
        around[m] = bits[(m - 3) % n]
    profile = np.empty(count)
    turn_c, turn_s = math.cos(2 * math.pi / count), math.sin(2 * math.pi / count)
    c, s_ = math.cos(math.pi / count), -math.sin(math.pi / count)
    for i in range(count):
        angle = 2 * math.pi * (i + 0.5) / count
        c, s_ = c * turn_c - s_ * turn_s, s_ * turn_c + c * turn_s
        along = math.sqrt((a11 * c + a12 * s_) ** 2 + (a12 * c + a22 * s_) ** 2)
        # Pixels per dot radius perpendicular to the ring's edge, and per radian to a border's.
        across = det / math.sqrt((a22 * c - a12 * s_) ** 2 + (a11 * s_ - a12 * c) ** 2)
        side = det / along
        radial = 0.0
        mean_radius = 0.0
        for j in range(len(radii)):
            z_in, z_out = (radii[j] - inner) * across / s, (radii[j] - outer) * across / s
            radial += (phi(z_in) - phi(z_out)) / len(radii)
            mean_radius += radii[j] / len(radii)
        turn = (angle - phase) / pitch
        k = math.floor(turn)
        scale = pitch * mean_radius * side / s
        value = around[k + 1] + 0.0
        for m in range(k - 1, k + 3):
            jump = around[m + 3] - around[m + 2]
            if jump != 0:
                value += jump * phi((turn - m) * scale)
        profile[i] = value * radial
    return profile


class View(NamedTuple):
    """How a ring is seen.

    The dot's centre and root A, the perspective's share (see `ring_profile`), the ring's radii in
    dot radii, the blur in px.
    """

    col: float
    row: float
    a11: float
    a12: float
    a22: float
    lean_x: float
    lean_y: float
    inner: float
    outer: float
    s: float


@numba.njit(cache=True, error_model="numpy")
def _profile(image, view, radii, count):
    return ring_profile(
        image, view.col, view.row, view.a11, view.a12, view.a22, view.lean_x, view.lean_y,
        radii, count,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _expected(view, bits, phase, radii, count):
    return expected_profile(
        view.a11, view.a12, view.a22, view.inner, view.outer, bits, phase, view.s, radii, count
    )


@numba.njit(cache=True, error_model="numpy")
def _set_bits(view, values, radii, bits, facts):
    """Fill the bits from the sectors' means, with margin and largest value."""
    bits[:] = 1
    places = np.int64(16)
    all_set = _expected(view, bits, 0.0, radii, places)
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
    """Fill how far the profile is off what the bits let expect, and return it."""
    count = len(ring)
    error = _expected(view, bits, facts[PHASE], radii, count)
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
        seen = _profile(image, view, at, count)
        expected = _expected(view, bits, facts[PHASE], at, count)
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
    gap = _profile(image, view, at, count)
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
    dot = _profile(image, view, at, count)
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
        RMS error of the profile against what the bits let expect; GAP, the largest deviation there;
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
    ring = _profile(image, view, radii, count)
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


NONE, CUT, NO_RING, UNCLEAR, COVERED, FILLED, OTHER_WIDTH, SHADED, NO_DOT = range(9)
"""What may speak against a ring, in the order in which it is asked; or against its dot."""


@numba.njit(cache=True, error_model="numpy")
def doubt(facts):
    """Return what speaks against a ring, from the facts of `read_ring`."""
    if math.isnan(facts[PHASE]):
        return CUT
    if facts[LARGEST] < 0.5 or facts[PROFILE_RMS] > 2.0 * MAX_PROFILE_RMS:
        return NO_RING
    if facts[MARGIN] < MIN_MARGIN:
        return UNCLEAR
    if facts[SECTOR_ERROR] > MAX_SECTOR_ERROR or facts[PROFILE_RMS] > MAX_PROFILE_RMS:
        return COVERED
    if facts[GAP] > MAX_GAP:
        return FILLED
    if max(facts[BEFORE], facts[BEYOND]) > MAX_BESIDE:
        return OTHER_WIDTH
    if facts[STANDS_OUT] > 1.0:
        return SHADED
    return NONE


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
