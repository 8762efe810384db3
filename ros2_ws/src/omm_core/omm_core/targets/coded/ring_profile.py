"""Grey values around a dot as a profile, and the profile that a ring's bits predict."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from omm_core.targets.conic.outline import (
    between,
    inside,
)

SAMPLES = 8
"""Samples of the ring per sector."""


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
def profile_of(image, view, radii, count):
    """Return the `ring_profile` of a view."""
    return ring_profile(
        image, view.col, view.row, view.a11, view.a12, view.a22, view.lean_x, view.lean_y,
        radii, count,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def expected_of(view, bits, phase, radii, count):
    """Return the `expected_profile` of a view."""
    return expected_profile(
        view.a11, view.a12, view.a22, view.inner, view.outer, bits, phase, view.s, radii, count
    )
