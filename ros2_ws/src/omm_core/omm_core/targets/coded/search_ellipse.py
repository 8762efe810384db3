"""The ellipse that a dot's edge may have, by rays from its middle in the image at half size."""

from __future__ import annotations

import math

import numba
import numpy as np

RAYS = 16
COS = np.cos(2 * np.pi * np.arange(48) / 48)
SIN = np.sin(2 * np.pi * np.arange(48) / 48)
_ORDER = np.array([2, 10, 6, 14, 0, 8, 4, 12, 1, 9, 5, 13, 3, 11, 7, 15])
"""Rays in opposite pairs, the slanting ones first: row and column have been looked at."""


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
        c, s = COS[3 * i], SIN[3 * i]
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
        b += q * COS[6 * i] * 2 / chords
        c2 += q * SIN[6 * i] * 2 / chords
        off = 0.5 * (lengths[i] - lengths[i + RAYS // 2]) * q * 2 / chords
        gx += off * COS[3 * i]
        gy += off * SIN[3 * i]
    return a, b, c2, gx, gy


@numba.njit(cache=True, error_model="numpy")
def _fits_chords(lengths, chords, a, b, c2, times):
    """Return whether no chord is far off the ellipse, by `times` what is allowed at last."""
    for k in range(chords):
        i = k * (RAYS // 2) // chords
        half_chord = 0.5 * (lengths[i] + lengths[i + RAYS // 2])
        q = a + b * COS[6 * i] + c2 * SIN[6 * i]
        if q <= 0.0 or abs(1.0 / math.sqrt(q) - half_chord) > times * (0.6 + 0.1 * half_chord):
            return False
    return True


@numba.njit(cache=True, error_model="numpy")
def ellipse(half, col, row, level, sign, reach):
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
