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

RAYS = 16
_COS = np.cos(2 * np.pi * np.arange(48) / 48)
_SIN = np.sin(2 * np.pi * np.arange(48) / 48)
_ORDER = np.array([2, 10, 6, 14, 0, 8, 4, 12, 1, 9, 5, 13, 3, 11, 7, 15])
"""Rays in opposite pairs, the slanting ones first: row and column have been looked at."""


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
        for k in range(edges):
            x, peak = edge_x[k], edge_d[k]
            if k > 0 and (edge_d[k - 1] > 0) != (peak > 0):
                left = edge_x[k - 1]
                if 2 <= x - left <= max_run:
                    count = _test_run(
                        half, left, x, y, peak < 0, contrast, ratios, seen, found, count
                    )
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
    ok, col, row, xx, xy, yy = _ellipse(
        half, 0.5 * (left + right), y + 0.5 * (down - up), level, sign, reach
    )
    if not ok:
        return count
    if not _ring_like(half, col, row, xx, xy, yy, level, sign, gap_ratio, read_ratio):
        return count
    r = 0.7 / math.sqrt(xx + yy)
    y0, y1 = max(int(row - r) >> 1, 0), min((int(row + r) >> 1) + 1, seen.shape[0])
    x0, x1 = max(int(col - r) >> 1, 0), min((int(col + r) >> 1) + 1, seen.shape[1])
    seen[y0:y1, x0:x1] = 1
    found[count, 0], found[count, 1] = col, row
    found[count, 2], found[count, 3], found[count, 4] = xx, xy, yy
    found[count, 5] = sign
    return count + 1


@numba.njit(cache=True, error_model="numpy")
def _between(half, col, row):
    """Return the bilinear grey value; the place must be inside the image."""
    x, y = int(col), int(row)
    fx, fy = col - x, row - y
    top = (1 - fx) * half[y, x] + fx * half[y, x + 1]
    bottom = (1 - fx) * half[y + 1, x] + fx * half[y + 1, x + 1]
    return (1 - fy) * top + fy * bottom


@numba.njit(cache=True, error_model="numpy")
def _crossing(half, col, row, c, s, t, level, sign):
    """Return where a ray crosses the level, near step t.

    The nearest pixel at that step is the first below the level.
    """
    now = sign * (_between(half, col + t * c, row + t * s) - level)
    if now > 0.0:
        t += 1
        before, now = now, sign * (_between(half, col + t * c, row + t * s) - level)
    else:
        before = sign * (_between(half, col + (t - 1) * c, row + (t - 1) * s) - level)
        if before <= 0.0 and t > 1:
            t -= 1
            now = before
            before = sign * (_between(half, col + (t - 1) * c, row + (t - 1) * s) - level)
    return t - 1 + (before / (before - now) if before > 0.0 >= now else 0.5)


@numba.njit(cache=True, error_model="numpy")
def _ray_lengths(half, col, row, level, sign, reach, turn, lengths):
    """Fill how far it is from (col, row) to the first crossing of `level` on each ray.

    Half of the rays are looked at in turn 0, which finds the middle. Return False where a ray does
    not cross, or opposite ones differ by more than the middle may be off.
    """
    height, width = half.shape
    rays = RAYS // 2 if turn == 0 else RAYS
    for k in range(rays):
        i = _ORDER[(k + 8 * turn) % RAYS]
        c, s = _COS[3 * i], _SIN[3 * i]
        t = 0
        now = 0
        across, down = col + 0.5, row + 0.5
        while True:
            t += 1
            before = now
            across += c
            down += s
            x, y = int(across), int(down)
            if t > reach or x < 2 or y < 2 or x >= width - 2 or y >= height - 2:
                return False
            now = sign * (np.int64(half[y, x]) - level)
            if now <= 0:
                break
        # To find the middle the nearest pixels are enough.
        lengths[i] = t - 1 + (before / (before - now) if before > 0 else 0.5)
        if turn == 1:
            lengths[i] = _crossing(half, col, row, c, s, t, level, sign)
        if k % 2 == 1:
            opposite = lengths[i - RAYS // 2]
            pair, differ = lengths[i] + opposite, abs(lengths[i] - opposite)
            if differ > (2.0 + 0.25 * pair if turn == 0 else 1.4 + 0.1 * pair):
                return False
    return True


@numba.njit(cache=True, error_model="numpy")
def _through_chords(lengths, chords):
    """Return the ellipse through half of the chords, and how far its centre is away.

    Returns
    -------
    a : mean of 1/r². b, c2 : how it differs by direction. gx, gy : gradient at the start.
    """
    a = b = c2 = gx = gy = 0.0
    for k in range(chords):
        i = k * (RAYS // 2) // chords
        half_chord = 0.5 * (lengths[i] + lengths[i + RAYS // 2])
        q = 1.0 / (half_chord * half_chord + 0.02)
        a += q / chords
        b += q * _COS[6 * i] * 2 / chords
        c2 += q * _SIN[6 * i] * 2 / chords
        off = 0.5 * (lengths[i] - lengths[i + RAYS // 2]) * q * 2 / chords
        gx += off * _COS[3 * i]
        gy += off * _SIN[3 * i]
    return a, b, c2, gx, gy


@numba.njit(cache=True, error_model="numpy")
def _fits_chords(lengths, chords, a, b, c2, times):
    """Return whether no chord is far off the ellipse, by `times` what is allowed at last."""
    for k in range(chords):
        i = k * (RAYS // 2) // chords
        half_chord = 0.5 * (lengths[i] + lengths[i + RAYS // 2])
        q = a + b * _COS[6 * i] + c2 * _SIN[6 * i]
        if q <= 0.0 or abs(1.0 / math.sqrt(q) - half_chord) > times * (0.6 + 0.1 * half_chord):
            return False
    return True


@numba.njit(cache=True, error_model="numpy")
def _ellipse(half, col, row, level, sign, reach):
    """Return the ellipse through the first crossings of `level` on rays from (col, row)."""
    height, width = half.shape
    lengths = np.empty(RAYS)
    a = b = c2 = 0.0
    for turn in range(2):
        if not _ray_lengths(half, col, row, level, sign, reach, turn, lengths):
            return False, 0.0, 0.0, 0.0, 0.0, 0.0
        chords = RAYS // 4 if turn == 0 else RAYS // 2
        a, b, c2, gx, gy = _through_chords(lengths, chords)
        det = a * a - b * b - c2 * c2
        if det <= 0.048 * a * a or not _fits_chords(lengths, chords, a, b, c2, 2 - turn):
            return False, 0.0, 0.0, 0.0, 0.0, 0.0
        if turn == 0:
            col += ((a - b) * gx - c2 * gy) / det
            row += ((a + b) * gy - c2 * gx) / det
            if not (1 <= col < width - 2 and 1 <= row < height - 2):
                return False, 0.0, 0.0, 0.0, 0.0, 0.0
    return True, col, row, a + b, c2, a - b


@numba.njit(cache=True, error_model="numpy")
def _ring_like(half, col, row, xx, xy, yy, level, sign, gap_ratio, read_ratio):
    """Return whether the gap is clear, and something is set at the ring's radius."""
    height, width = half.shape
    for ratio in (gap_ratio, 0.5):
        total = squares = 0.0
        for i in range(0, 48, 3):
            c, s = _COS[i], _SIN[i]
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
        c, s = _COS[i], _SIN[i]
        r = read_ratio / math.sqrt(xx * c * c + 2 * xy * c * s + yy * s * s)
        x, y = int(col + r * c + 0.5), int(row + r * s + 0.5)
        if 0 <= x < width and 0 <= y < height:
            set_samples += sign * (half[y, x] - background) > 0.4 * step
    # No family has a ring that is set all around: that is a hole in something bright, or a stroke.
    return 3 <= set_samples <= 46
