"""Search for dots with something ring-like around them, in the image at half size.

Every second row is scanned for pairs of opposite edges. A pair whose middle is also that of the
column through it may be the centre of a dot: rays to 16 sides must then meet the dot's edge where
an ellipse has it, the gap around must be clear, and at the ring's radius something must be set.
Each test is cheaper than the next and turns most of the remaining away, so clutter costs little.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from omm_core.targets.coded.search_ellipse import COS, SIN, ellipse


def step_above(half: NDArray[Any], step: int) -> int:
    """Step that stands out of most of the image, at least `step` and at most three times that.

    It is what rough ground asks for (machining marks, noise); a sheet with many targets has as many
    edges, and rests between them.
    """
    rows = half[::32].astype(np.int32)
    differences = np.abs(rows[:, 2:] - rows[:, :-2]).ravel()
    most = 3 * len(differences) // 4
    rough = float(np.partition(differences, most)[most])
    return int(min(max(4.0 * rough + 1.0, step), 3 * step))


@numba.njit(cache=True, error_model="numpy")
def find_dots(half, step, most_step, contrast, max_run, gap_ratio, read_ratio, found):
    """Write candidates to `found` and return how many there are.

    Parameters
    ----------
    half : (H, W) unsigned integers, the image at half size.
    step, most_step : smallest grey difference over two pixels that counts as an edge, in general
        and where there are edges everywhere (see `step_above`).
    contrast : smallest difference of dot and background.
    max_run : largest width of a dot, px at half size.
    gap_ratio, read_ratio : radii (in dot radii) of the middle of the gap and of the ring.
    found : (N, 6) float64; col, row (px at half size), the conic's xx, xy, yy (1/px²), polarity.
    """
    height, width = half.shape
    seen = np.zeros(((height >> 1) + 2, (width >> 1) + 2), dtype=np.uint8)
    steep = np.zeros((width + 7) // 8 * 8, dtype=np.uint8)
    eights = steep.view(np.uint64)
    edge_x, edge_d = np.empty(width, dtype=np.int64), np.empty(width, dtype=np.int64)
    # Typed, so that what is called is compiled for one type only.
    count = np.int64(0)
    least_step, least_contrast, ratios = step, contrast, (gap_ratio, read_ratio)
    # Every second row: of a dot's rows at least two next to each other pass as its middle.
    for y in range(2, height - 2, 2):
        row = half[y]
        for x in range(2, width - 2):
            d = np.int32(row[x + 1]) - np.int32(row[x - 1])
            steep[x] = abs(d) >= step
        edges = _edges(row, steep, eights, edge_x, edge_d)
        strong_x, strong = np.int64(-1), np.int64(0)
        first_x = np.int64(-1)
        for k in range(edges):
            x, peak = edge_x[k], edge_d[k]
            turns = k > 0 and (edge_d[k - 1] > 0) != (peak > 0)
            if turns:
                left = edge_x[k - 1]
                if 2 <= x - left <= max_run:
                    count = _test_run(
                        half, left, x, y, peak < 0, contrast, ratios, seen, found, count
                    )
            # Where light falls across the dot, that is one more step of the same sign.
            new = first_x != strong_x and first_x != edge_x[k - 1]
            if turns and new and 2 <= x - first_x <= max_run:
                count = _test_run(
                    half, first_x, x, y, peak < 0, contrast, ratios, seen, found, count
                )
            if k == 0 or turns or x - first_x > max_run:
                first_x = x
            # What lies within the dot may have edges too: the outer ones are stronger.
            outer = strong != 0 and strong_x != edge_x[k - 1] and (strong > 0) != (peak > 0)
            if outer and 2 <= x - strong_x <= max_run and 3 * abs(peak) >= abs(strong):
                count = _test_run(
                    half, strong_x, x, y, peak < 0, contrast, ratios, seen, found, count
                )
            if 3 * abs(peak) >= abs(strong) or x - strong_x > max_run:
                strong_x, strong = x, peak
        # On rough ground more must be asked of an edge.
        step = min(step + 2, most_step) if edges > width >> 5 else max(step - 1, least_step)
        contrast = least_contrast * step // least_step
    return count


@numba.njit(cache=True, error_model="numpy")
def _edges(row, steep, eights, edge_x, edge_d):
    """Return where a row is steepest in each stretch of `steep` of one sign; how many there are."""
    count = 0
    peak = np.int64(0)
    peak_x = 0
    for word in range(len(eights)):
        if eights[word] == 0 and peak == 0:
            continue
        for x in range(8 * word, 8 * word + 8):
            d = np.int64(row[x + 1]) - np.int64(row[x - 1]) if steep[x] else np.int64(0)
            if (d > 0) == (peak > 0) and (d < 0) == (peak < 0):
                if abs(d) > abs(peak):
                    peak, peak_x = d, x
                continue
            if peak != 0:
                edge_x[count], edge_d[count] = peak_x, peak
                count += 1
            peak, peak_x = d, x
    return count


@numba.njit(cache=True, error_model="numpy")
def _test_run(half, left, right, y, bright, contrast, ratios, seen, found, count):
    height, width = half.shape
    gap_ratio, read_ratio = ratios
    x = (left + right) >> 1
    sign = 1 if bright else -1
    if seen[y >> 1, x >> 1] or count >= len(found):
        return count
    inside = np.int64(half[y, x])
    outside = (
        np.int64(half[y, max(left - 2, 0)]) + np.int64(half[y, min(right + 2, width - 1)])
    ) >> 1
    if sign * (inside - outside) < contrast:
        return count
    level = (inside + outside) >> 1
    # The gap beside the dot, in this row and then in the column.
    near_gap = 0.5 * (1.0 + 0.85 * (gap_ratio - 1.0))
    away = near_gap * (right - left)
    for at in (int(0.5 * (left + right) - away + 0.5), int(0.5 * (left + right) + away + 0.5)):
        if 0 <= at < width and sign * (np.int64(half[y, at]) - level) > 0:
            return count
    limit = 3 * (right - left) // 2 + 4
    up = 1
    while up <= limit and y - up >= 0 and sign * (np.int64(half[y - up, x]) - level) > 0:
        up += 1
    if up > limit or y - up < 0:
        return count
    down = 1
    most = up + 2 + (up >> 3)
    while down <= most and y + down < height and sign * (np.int64(half[y + down, x]) - level) > 0:
        down += 1
    if down > most or y + down >= height or up > down + 2 + (down >> 3):
        return count
    if right - left > 3 * (up + down):
        return count
    middle = y + 0.5 * (down - up)
    away = near_gap * (up + down - 1)
    for at in (int(middle - away + 0.5), int(middle + away + 0.5)):
        if 0 <= at < height and sign * (np.int64(half[at, x]) - level) > 0:
            return count
    # Of an ellipse, three times as long as wide and slanting, the longer half is within this.
    reach = int(1.2 * max(right - left, up + down)) + 3
    across = 0.5 * (left + right)
    ok, col, row, xx, xy, yy = ellipse(half, across, middle, level, sign, reach)
    if not ok or not _ring_like(half, col, row, xx, xy, yy, sign, gap_ratio, read_ratio):
        if not _falls(half, x, y, (right - left) >> 2, (up + down) >> 2):
            return count
        if not ok or not _in_proportion(half, col, row, xx, xy, yy, sign, gap_ratio, read_ratio):
            # Where light falls across a dot, its dark side lies below half of its middle.
            level = (inside + 3 * outside) >> 2
            ok, col, row, xx, xy, yy = ellipse(half, across, middle, level, sign, reach)
            ok = ok and _in_proportion(half, col, row, xx, xy, yy, sign, gap_ratio, read_ratio)
        if not ok:
            return count
    _mark(seen, col, row, 0.7 / math.sqrt(xx + yy))
    found[count, 0], found[count, 1] = col, row
    found[count, 2], found[count, 3], found[count, 4] = xx, xy, yy
    found[count, 5] = sign
    return count + 1


@numba.njit(cache=True, error_model="numpy")
def _mark(seen, col, row, r):
    """Mark the square of half width r around a dot's middle as seen."""
    y0, y1 = max(int(row - r) >> 1, 0), min((int(row + r) >> 1) + 1, seen.shape[0])
    x0, x1 = max(int(col - r) >> 1, 0), min((int(col + r) >> 1) + 1, seen.shape[1])
    seen[y0:y1, x0:x1] = 1


@numba.njit(cache=True, error_model="numpy")
def _falls(half, x, y, aside, above):
    """Return whether the light falls by a third and more across what may be a dot."""
    left, right = np.int64(half[y, x - aside]), np.int64(half[y, x + aside])
    upper, lower = np.int64(half[y - above, x]), np.int64(half[y + above, x])
    least = min(min(left, right), min(upper, lower))
    return 2 * max(max(left, right), max(upper, lower)) > 3 * least + 2


@numba.njit(cache=True, error_model="numpy")
def _in_proportion(half, col, row, xx, xy, yy, sign, gap_ratio, read_ratio):
    """Return whether dot, gap and ring differ *in proportion* on all sides, as `_ring_like`."""
    height, width = half.shape
    set_samples = 0
    for i in range(48):
        c, s = COS[i], SIN[i]
        r = 1.0 / math.sqrt(xx * c * c + 2 * xy * c * s + yy * s * s)
        x, y = int(col + read_ratio * r * c + 0.5), int(row + read_ratio * r * s + 0.5)
        if not (0 <= x < width and 0 <= y < height):
            return False
        on = np.int64(half[y, x])
        gap = np.int64(half[int(row + gap_ratio * r * s + 0.5), int(col + gap_ratio * r * c + 0.5)])
        dot = np.int64(half[int(row + 0.5 * r * s + 0.5), int(col + 0.5 * r * c + 0.5)])
        if not _differ(dot, gap, sign):
            return False
        set_samples += _differ(on, gap, sign)
    return 3 <= set_samples <= 46


@numba.njit(cache=True, error_model="numpy")
def _differ(one, other, sign):
    """Return whether one is brighter (sign 1) or darker than the other by half of the darker."""
    high, low = (one, other) if sign > 0 else (other, one)
    return 2 * high > 3 * low + 2


@numba.njit(cache=True, error_model="numpy")
def _ring_like(half, col, row, xx, xy, yy, sign, gap_ratio, read_ratio):
    """Return whether the gap is clear, and something is set at the ring's radius."""
    height, width = half.shape
    for ratio in (gap_ratio, 0.5):
        total = squares = 0.0
        for i in range(0, 48, 3):
            c, s = COS[i], SIN[i]
            r = ratio / math.sqrt(xx * c * c + 2 * xy * c * s + yy * s * s)
            x, y = int(col + r * c + 0.5), int(row + r * s + 0.5)
            if not (0 <= x < width and 0 <= y < height):
                return False
            v = half[y, x] + 0.0
            total += v / 16
            squares += v * v / 16
        scatter = squares - total * total
        if ratio == gap_ratio:
            background = total
            clear = scatter
    dot = total
    step = sign * (dot - background)
    if step <= 0.0 or clear > (0.25 * step) ** 2 or scatter > (0.25 * step) ** 2:
        return False
    set_samples = 0
    for i in range(48):
        c, s = COS[i], SIN[i]
        r = read_ratio / math.sqrt(xx * c * c + 2 * xy * c * s + yy * s * s)
        x, y = int(col + r * c + 0.5), int(row + r * s + 0.5)
        if 0 <= x < width and 0 <= y < height:
            set_samples += sign * (half[y, x] - background) > 0.4 * step
    # No family has a ring that is set all around: that is a hole in something bright, or a stroke.
    return 3 <= set_samples <= 46
