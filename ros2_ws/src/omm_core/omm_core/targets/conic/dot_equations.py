"""The normal equations of a dot's pixels."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from omm_core.numerics.linear_algebra import invert, product
from omm_core.targets.conic.dot_model import (
    B0,
    BX,
    CHI2,
    CLEAR_PIXELS,
    CLEAR_SQUARES,
    F0,
    FX,
    PARAMETERS,
    PIXELS,
    SET_PIXELS,
    SET_SQUARES,
    Floats,
    find_clipped,
    linearise,
    place,
    shares,
)

SETTLED = 4
"""Turns after which the set of pixels does not change any more, so that costs can be compared."""


class SlopesPrior(NamedTuple):
    """Information (4, 4) and mean (4,) of the slopes (fx, fy, bx, by)."""

    information: Floats
    mean: Floats


class _Room(NamedTuple):
    """What a fit knows of its pixels, see dot_model.py."""

    pixels: Floats
    flat: Floats
    geometry: Floats
    rows: Floats
    rests: Floats
    clipped: NDArray[np.bool_]


class _Equations(NamedTuple):
    """Normal equations, scaled, their solution, and room for it."""

    normal: Floats
    right: Floats
    scaled: Floats
    scale: Floats
    inverse: Floats
    step: Floats


class Best(NamedTuple):
    """The best parameters so far, with their normal equations."""

    p: Floats
    right: Floats
    normal: Floats


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _add_flat(flat, p, noise, normal, right, statistics):
    """Add what the wholly set [0] and the wholly clear [1] pixels tell: of light only."""
    for kind in range(2):
        at = F0 if kind == 0 else B0
        sums, level, slope_x, slope_y = flat[kind], p[at], p[at + 1], p[at + 2]
        w = 1.0 / (noise.read + noise.gain * max(level, 0.0))
        normal[at, at] += w * sums[0]
        normal[at + 1, at] += w * sums[1]
        normal[at + 2, at] += w * sums[2]
        normal[at + 1, at + 1] += w * sums[3]
        normal[at + 2, at + 1] += w * sums[4]
        normal[at + 2, at + 2] += w * sums[5]
        rest_0 = sums[6] - level * sums[0] - slope_x * sums[1] - slope_y * sums[2]
        rest_x = sums[7] - level * sums[1] - slope_x * sums[3] - slope_y * sums[4]
        rest_y = sums[8] - level * sums[2] - slope_x * sums[4] - slope_y * sums[5]
        right[at] += w * rest_0
        right[at + 1] += w * rest_x
        right[at + 2] += w * rest_y
        squares = (
            sums[9]
            - level * (sums[6] + rest_0)
            - slope_x * (sums[7] + rest_x)
            - slope_y * (sums[8] + rest_y)
        )
        statistics[SET_PIXELS if kind == 0 else CLEAR_PIXELS] += sums[0]
        statistics[SET_SQUARES if kind == 0 else CLEAR_SQUARES] += squares
        statistics[CHI2] += w * squares
        statistics[PIXELS] += sums[0]


@numba.njit(cache=True, error_model="numpy")
def _add_prior(light, p, normal, right):
    """Add what the ring tells of the slopes (fx, fy, bx, by); return its weighted square."""
    prior, mean = light.information, light.mean
    cost = 0.0
    for j in range(4):
        a = FX + j if j < 2 else BX + j - 2
        for k in range(4):
            c = FX + k if k < 2 else BX + k - 2
            pull = prior[j, k] * (mean[k] - p[c])
            right[a] += pull
            cost += (mean[j] - p[a]) * pull
            if c <= a:
                normal[a, c] += prior[j, k]
    return cost


@numba.njit(cache=True, error_model="numpy")
def solve(equations, damping):
    """Fill the step and the scaled normal matrix' inverse; return False where there is none.

    The matrix is scaled to a diagonal of 1 + damping.
    """
    normal, right, scaled = equations.normal, equations.right, equations.scaled
    scale, inverse, step = equations.scale, equations.inverse, equations.step
    n = len(right)
    for j in range(n):
        if not normal[j, j] > 0.0:
            return False
        scale[j] = 1.0 / math.sqrt(normal[j, j])
    for j in range(n):
        for k in range(j + 1):
            scaled[j, k] = normal[j, k] * scale[j] * scale[k]
        scaled[j, j] = 1.0 + damping
    if not invert(scaled, inverse):
        return False
    for j in range(n):
        step[j] = 0.0
        for k in range(n):
            step[j] += inverse[j, k] * right[k] * scale[k]
        step[j] *= scale[j]
    return True


@numba.njit(cache=True, error_model="numpy")
def centre_covariance(equations, covariance):
    """Fill the covariance (2, 2) of (col, row)."""
    inverse, scale = equations.inverse, equations.scale
    covariance[0, 0] = inverse[0, 0] * scale[0] * scale[0]
    covariance[0, 1] = covariance[1, 0] = inverse[0, 1] * scale[0] * scale[1]
    covariance[1, 1] = inverse[1, 1] * scale[1] * scale[1]


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def rooms(extent):
    """Return the room for a window of a half width, and for the equations."""
    most, n = int(2.0 * extent + 4.0) ** 2, np.int64(PARAMETERS)
    room = _Room(
        np.empty((3, most)), np.zeros((2, 10)), np.empty((5, most)), np.empty((PARAMETERS, most)),
        np.empty(most), np.zeros(most, dtype=np.bool_),
    )  # fmt: skip
    equations = _Equations(
        np.empty((n, n)), np.empty(n), np.empty((n, n)), np.empty(n), np.empty((n, n)), np.empty(n)
    )
    return room, equations, Best(np.empty(n), np.empty(n), np.empty((n, n)))


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def look(p, used, turn, window, ring, noise, room, statistics):
    """Fill rows and rests at p; return whether what is clipped may still change."""
    pixels, geometry, clipped = room.pixels, room.geometry, room.clipped
    place(pixels, used, p, geometry)
    shares(pixels, geometry, used, p, window, ring)
    some = False
    if turn < SETTLED:
        # Which pixels are clipped is settled in the first turns, lest they come and go.
        some = find_clipped(pixels, geometry, used, p, window, noise, turn < 2, clipped)
    linearise(pixels, geometry, used, p, window, noise, clipped, room.rows, room.rests, statistics)
    return some and turn < SETTLED - 1


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def set_equations(fitted, used, levels, noise, light, room, equations):
    """Fill the normal equations from the rows; return the cost."""
    p, statistics = fitted.p, fitted.statistics
    rows, rests, normal, right = room.rows, room.rests, equations.normal, equations.right
    for j in range(len(right)):
        right[j] = product(rows[j], rests, used)
        for k in range(j + 1):
            normal[j, k] = product(rows[j], rows[k], used)
    _add_flat(room.flat, p, noise, normal, right, statistics)
    cost = statistics[CHI2] + _add_prior(light, p, normal, right)
    # Where all of the dot is saturated only its edge tells of F: hold it loosely.
    f_start, b_start = levels
    loose = 1.0 / (f_start - b_start) ** 2
    normal[F0, F0] += loose
    normal[B0, B0] += loose
    right[F0] += loose * (f_start - p[F0])
    right[B0] += loose * (b_start - p[B0])
    return cost + loose * ((f_start - p[F0]) ** 2 + (b_start - p[B0]) ** 2)
