"""The dot's centre by weighted least squares of `dot_model`: at the Cramér–Rao bound.

Pixels are weighted with their variance, read² + gain · I; saturated pixels are left out by what the
model expects of them, not by what they show, so they do not pull.

The centre's covariance is that of the fit. Free slopes of F would cost up to 40 % of the accuracy
of a dot of 12 px, so they get what the ring's set and clear areas tell about them as prior
(`light_kernels.ring_light`), loosened by how much light may curve over the ring's width.

Any error of the model that is symmetric about the centre leaves the centre unbiased.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from omm_core.numerics.linear_algebra import copy_to, invert, product
from omm_core.targets.conic.dot_model import (
    PARAMETERS,
    find_clipped,
    linearise,
    place,
    shares,
    sort_pixels,
)
from omm_core.targets.conic.outline import square_root

MAX_TURNS = 25
SETTLED = 4
"""Turns after which the set of pixels does not change any more, so that costs can be compared."""
FIRST_DAMPING = 0.1


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _add_flat(flat, p, read, gain, normal, right, statistics):
    """Add what the wholly set [0] and the wholly clear [1] pixels tell: of light only."""
    for kind in range(2):
        at = 6 + 3 * kind
        sums, level, slope_x, slope_y = flat[kind], p[at], p[at + 1], p[at + 2]
        w = 1.0 / (read + gain * max(level, 0.0))
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
        statistics[2 * kind] += sums[0]
        statistics[2 * kind + 1] += squares
        statistics[4] += w * squares
        statistics[5] += sums[0]


@numba.njit(cache=True, error_model="numpy")
def _add_prior(prior, mean, p, normal, right):
    """Add what the ring tells of the slopes (fx, fy, bx, by); return its weighted square."""
    cost = 0.0
    for j in range(4):
        a = 7 + j if j < 2 else 8 + j
        for k in range(4):
            c = 7 + k if k < 2 else 8 + k
            pull = prior[j, k] * (mean[k] - p[c])
            right[a] += pull
            cost += (mean[j] - p[a]) * pull
            if c <= a:
                normal[a, c] += prior[j, k]
    return cost


@numba.njit(cache=True, error_model="numpy")
def _solve(normal, right, damping, scaled, scale, inverse, step):
    """Fill the step and the scaled normal matrix' inverse; return False where there is none.

    The matrix is scaled to a diagonal of 1 + damping.
    """
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
def _centre_covariance(inverse, scale, covariance):
    """Fill the covariance (2, 2) of (col, row)."""
    covariance[0, 0] = inverse[0, 0] * scale[0] * scale[0]
    covariance[0, 1] = covariance[1, 0] = inverse[0, 1] * scale[0] * scale[1]
    covariance[1, 1] = inverse[1, 1] * scale[1] * scale[1]


@numba.njit(cache=True, error_model="numpy")
def _bold(p, step, move):
    """Return the share of a step that the model's curvature allows."""
    factor = 1.0
    if move > 1.0:
        factor = 1.0 / move
    if abs(step[5]) > 0.4 * p[5]:
        factor = min(factor, 0.4 * p[5] / abs(step[5]))
    level = abs(p[6] - p[9])
    for bright in (6, 9):
        if abs(step[bright]) > 0.5 * level:
            factor = min(factor, 0.5 * level / abs(step[bright]))
    return factor


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def fit_dot(
    image,
    start,
    sign,
    inner,
    bits,
    phase,
    read,
    gain,
    saturation,
    prior,
    prior_mean,
    p,
    covariance,
    statistics,
):
    """Fit the model of the module's docstring.

    Parameters
    ----------
    start : (9,) from `outline.outline`; where the slopes' coordinates begin and the window lies.
    sign : +1 bright dot, -1 dark dot.
    inner, bits, phase : the ring's inner radius (dot radii), its bits, where they begin (rad).
    read, gain : variance of a grey value I is read + gain I.
    saturation : grey value from which on a pixel tells only "at least".
    prior, prior_mean : (4, 4) information and (4,) mean of (fx, fy, bx, by).
    p : (12,) in: start values, out: solution. covariance : (2, 2) out, px².
    statistics : (6,) out: pixels and sum of squares of the dot's half, of the background's half,
        χ² and pixels in all.

    Returns
    -------
    Whether the fit converged.
    """
    x0, y0 = start[0], start[1]
    a11, a12, a22 = square_root(start[2], start[3], start[4])
    area = a11 * a22 - a12 * a12
    r0 = math.sqrt(area)
    reach = max(math.sqrt(a11 * a11 + a12 * a12), math.sqrt(a12 * a12 + a22 * a22))
    s_start = p[5]
    n = np.int64(PARAMETERS)
    f_start, b_start = p[6], p[9]
    loose = 1.0 / (f_start - b_start) ** 2
    below = saturation - 4.5 * math.sqrt(read + gain * saturation)
    converged = False
    extent = (1.0 + 0.6 * (inner - 1.0)) * reach
    most = int(2.0 * extent + 4.0) ** 2
    pixels, flat = np.empty((3, most)), np.zeros((2, 10))
    geometry = np.empty((5, most))
    rows, rests = np.empty((PARAMETERS, most)), np.empty(most)
    clipped = np.zeros(most, dtype=np.bool_)
    normal, right, inverse = np.empty((n, n)), np.empty(n), np.empty((n, n))
    scaled, scale, step = np.empty((n, n)), np.empty(n), np.empty(n)
    best, best_right, best_normal = np.empty(n), np.empty(n), np.empty((n, n))
    lowest, damping = math.inf, 0.0
    used = np.int64(0)
    sorting = True
    for turn in range(MAX_TURNS):
        settling = turn == 0  # the centre may be right before the grey levels are
        if sorting:
            used = sort_pixels(image, start, p, inner, below, pixels, flat)
        place(pixels, used, p, geometry)
        shares(pixels, geometry, used, p, a11, a12, a22, inner, bits, phase)
        if turn < SETTLED:
            # Which pixels are clipped is settled in the first turns, lest they come and go.
            some = find_clipped(
                pixels, geometry, used, p, x0, y0, r0, read, gain, saturation, turn < 2, clipped
            )
            settling = settling or (some and turn < SETTLED - 1)
        linearise(
            pixels, geometry, used, p, x0, y0, r0, read, gain, clipped, rows, rests, statistics
        )
        for j in range(n):
            right[j] = product(rows[j], rests, used)
            for k in range(j + 1):
                normal[j, k] = product(rows[j], rows[k], used)
        _add_flat(flat, p, read, gain, normal, right, statistics)
        cost = statistics[4] + _add_prior(prior, prior_mean, p, normal, right)
        # Where all of the dot is saturated only its edge tells of F: hold it loosely.
        normal[6, 6] += loose
        normal[9, 9] += loose
        right[6] += loose * (f_start - p[6])
        right[9] += loose * (b_start - p[9])
        cost += loose * ((f_start - p[6]) ** 2 + (b_start - p[9]) ** 2)
        worse = turn >= SETTLED and cost > lowest * (1.0 + 1e-9)
        if worse:
            # Level, size and blur of what is saturated can hardly be told apart: step less far.
            damping = max(10.0 * damping, FIRST_DAMPING)
            copy_to(normal, best_normal)
            for j in range(n):
                p[j], right[j] = best[j], best_right[j]
        elif turn >= SETTLED - 1:
            lowest = cost
            damping *= 0.1
            copy_to(best_normal, normal)
            for j in range(n):
                best[j], best_right[j] = p[j], right[j]
        if not _solve(normal, right, damping, scaled, scale, inverse, step):
            return False
        move = math.sqrt(step[0] * step[0] + step[1] * step[1])
        factor = _bold(p, step, move)
        for j in range(n):
            p[j] += factor * step[j]
        # What is edge and what is flat is settled by the first step, unless that moves the edge by
        # so little that all that is edge has been taken for it already.
        bent = abs(step[2]) + 2.0 * abs(step[3]) + abs(step[4])
        moved = move + 0.5 * reach * reach * reach * bent + 4.2 * max(step[5], 0.0)
        sorting = turn == 0 and factor * moved > 0.2 * p[5]
        if p[5] < 0.29:
            p[5] = 0.29
        # What is saturated is at least as bright as that.
        if sign > 0.0 and f_start > below:
            p[6] = max(p[6], f_start)
        elif sign < 0.0 and b_start > below:
            p[9] = max(p[9], b_start)
        if not (p[2] > 0.0 and p[2] * p[4] > p[3] * p[3]) or p[5] > 4.0 * s_start + 2.0:
            return False
        if abs(p[0] - x0) > 0.5 * reach or abs(p[1] - y0) > 0.5 * reach:
            return False
        if factor < 1.0 or worse or settling:
            continue
        _centre_covariance(inverse, scale, covariance)
        # Below a quarter of the standard deviation; a twentieth of that step is left.
        limit = 0.03 * (covariance[0, 0] + covariance[1, 1]) + 1e-10
        if (move * (1.0 + damping)) ** 2 < limit:
            converged = True
            # The sums are from before this step, which takes so much off χ².
            statistics[4] = max(statistics[4] - product(step, right, n), 0.0)
            if damping > 0.0:
                converged = _solve(normal, right, 0.0, scaled, scale, inverse, step)
                _centre_covariance(inverse, scale, covariance)
            break
    return converged and sign * (p[6] - p[9]) > 0.0
