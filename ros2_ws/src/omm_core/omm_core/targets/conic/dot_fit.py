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
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from omm_core.numerics.linear_algebra import copy_to, invert, product
from omm_core.targets.conic.dot_model import (
    B0,
    BLUR,
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
    sort_pixels,
    window_of,
)
from omm_core.targets.conic.outline import COL, LEVEL_IN, LEVEL_OUT, ROW, WIDTH, XX, XY, YY

MAX_TURNS = 25
SETTLED = 4
"""Turns after which the set of pixels does not change any more, so that costs can be compared."""
FIRST_DAMPING = 0.1


class SlopesPrior(NamedTuple):
    """Information (4, 4) and mean (4,) of the slopes (fx, fy, bx, by)."""

    information: Floats
    mean: Floats


class Fitted(NamedTuple):
    """A dot's parameters (12,), the centre's covariance (2, 2) in px², and statistics (6,)."""

    p: Floats
    covariance: Floats
    statistics: Floats

    @property
    def contrast(self) -> float:
        """Return how much brighter the dot is than its background."""
        return float(self.p[F0] - self.p[B0])

    @property
    def misfit(self) -> float:
        """Return χ² by degree of freedom."""
        return float(self.statistics[CHI2]) / self._free

    @property
    def residual(self) -> float:
        """Return the root mean square of what the model leaves of the grey values."""
        squares = self.statistics[SET_SQUARES] + self.statistics[CLEAR_SQUARES]
        return math.sqrt(squares / (self._free + PARAMETERS))

    @property
    def _free(self) -> float:
        return max(float(self.statistics[PIXELS]) - PARAMETERS, 1.0)

    def noise(self, least: float) -> tuple[float, float]:
        """Return read and gain as dot and background show them; read is at least ``least``."""
        on_dot = self.statistics[SET_SQUARES] / max(self.statistics[SET_PIXELS], 1.0)
        beside = self.statistics[CLEAR_SQUARES] / max(self.statistics[CLEAR_PIXELS], 1.0)
        gain = max(on_dot - beside, 0.0) / max(self.contrast, 1.0)
        return max(beside - gain * max(float(self.p[B0]), 0.0), least), gain


def start_at(shape: Floats) -> Fitted:
    """Return an outline (9,) as what `fit_dot` starts from, without slopes."""
    p = np.zeros(PARAMETERS)
    p[: YY + 1] = shape[: YY + 1]
    p[BLUR] = max(float(shape[WIDTH]), 0.35)
    p[F0], p[B0] = shape[LEVEL_IN], shape[LEVEL_OUT]
    return Fitted(p, np.zeros((2, 2)), np.zeros(6))


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


class _Best(NamedTuple):
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
def _solve(equations, damping):
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
def _centre_covariance(equations, covariance):
    """Fill the covariance (2, 2) of (col, row)."""
    inverse, scale = equations.inverse, equations.scale
    covariance[0, 0] = inverse[0, 0] * scale[0] * scale[0]
    covariance[0, 1] = covariance[1, 0] = inverse[0, 1] * scale[0] * scale[1]
    covariance[1, 1] = inverse[1, 1] * scale[1] * scale[1]


@numba.njit(cache=True, error_model="numpy")
def _bold(p, step, move):
    """Return the share of a step that the model's curvature allows."""
    factor = 1.0
    if move > 1.0:
        factor = 1.0 / move
    if abs(step[BLUR]) > 0.4 * p[BLUR]:
        factor = min(factor, 0.4 * p[BLUR] / abs(step[BLUR]))
    level = abs(p[F0] - p[B0])
    for bright in (F0, B0):
        if abs(step[bright]) > 0.5 * level:
            factor = min(factor, 0.5 * level / abs(step[bright]))
    return factor


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _rooms(extent):
    """Return the room for a window of a half width, and for the equations."""
    most, n = int(2.0 * extent + 4.0) ** 2, np.int64(PARAMETERS)
    room = _Room(
        np.empty((3, most)), np.zeros((2, 10)), np.empty((5, most)), np.empty((PARAMETERS, most)),
        np.empty(most), np.zeros(most, dtype=np.bool_),
    )  # fmt: skip
    equations = _Equations(
        np.empty((n, n)), np.empty(n), np.empty((n, n)), np.empty(n), np.empty((n, n)), np.empty(n)
    )
    return room, equations, _Best(np.empty(n), np.empty(n), np.empty((n, n)))


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _look(p, used, turn, window, ring, noise, room, statistics):
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
def _set_equations(fitted, used, levels, noise, light, room, equations):
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


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _keep(best, p, equations):
    """Keep parameters and their equations as the best."""
    copy_to(best.normal, equations.normal)
    for j in range(len(p)):
        best.p[j], best.right[j] = p[j], equations.right[j]


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _go_back(best, p, equations):
    """Take the best parameters and their equations again."""
    copy_to(equations.normal, best.normal)
    for j in range(len(p)):
        p[j], equations.right[j] = best.p[j], best.right[j]


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _bound(p, levels, sign, below):
    """Hold the blur above that of a pixel, and what is saturated at least as bright as that."""
    f_start, b_start = levels
    if p[BLUR] < 0.29:
        p[BLUR] = 0.29
    if sign > 0.0 and f_start > below:
        p[F0] = max(p[F0], f_start)
    elif sign < 0.0 and b_start > below:
        p[B0] = max(p[B0], b_start)


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _lost(p, s_start, window):
    """Return whether p is no ellipse any more, or another one than that of the start."""
    if not (p[XX] > 0.0 and p[XX] * p[YY] > p[XY] * p[XY]) or p[BLUR] > 4.0 * s_start + 2.0:
        return True
    half = 0.5 * window.reach
    return abs(p[COL] - window.x0) > half or abs(p[ROW] - window.y0) > half


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _moved_edge(step, move, reach):
    """Return how far a step moves the edge, or what it blurs, at most (px)."""
    bent = abs(step[XX]) + 2.0 * abs(step[XY]) + abs(step[YY])
    return move + 0.5 * reach * reach * reach * bent + 4.2 * max(step[BLUR], 0.0)


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _has_settled(move, damping, equations, covariance):
    """Fill the centre's covariance; return whether the next step would change nothing.

    Below a quarter of the standard deviation; a twentieth of that step is left.
    """
    _centre_covariance(equations, covariance)
    limit = 0.03 * (covariance[0, 0] + covariance[1, 1]) + 1e-10
    return (move * (1.0 + damping)) ** 2 < limit


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _finish(fitted, damping, equations):
    """Fill χ² and covariance of the solution; return whether it has one."""
    statistics, step, right = fitted.statistics, equations.step, equations.right
    # The sums are from before this step, which takes so much off χ².
    statistics[CHI2] = max(statistics[CHI2] - product(step, right, len(right)), 0.0)
    converged = True
    if damping > 0.0:
        converged = _solve(equations, 0.0)
        _centre_covariance(equations, fitted.covariance)
    return converged


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def fit_dot(image, start, sign, ring, noise, light, fitted):
    """Fit the model of the module's docstring.

    Parameters
    ----------
    start : (9,) from `outline.outline`; where the slopes' coordinates begin and the window lies.
    sign : +1 bright dot, -1 dark dot.
    ring, noise, light : Ring, Noise, SlopesPrior
    fitted : Fitted, with the start in p; filled with the solution.

    Returns
    -------
    Whether the fit converged.
    """
    p = fitted.p
    window = window_of(start)
    s_start, levels = p[BLUR], (p[F0], p[B0])
    below = noise.saturation - 4.5 * math.sqrt(noise.read + noise.gain * noise.saturation)
    room, equations, best = _rooms((1.0 + 0.6 * (ring.inner - 1.0)) * window.reach)
    step = equations.step
    lowest, damping = math.inf, 0.0
    used = np.int64(0)
    sorting = True
    for turn in range(MAX_TURNS):
        if sorting:
            used = sort_pixels(image, start, p, ring.inner, below, room.pixels, room.flat)
        changing = _look(p, used, turn, window, ring, noise, room, fitted.statistics)
        cost = _set_equations(fitted, used, levels, noise, light, room, equations)
        worse = turn >= SETTLED and cost > lowest * (1.0 + 1e-9)
        if worse:
            # Level, size and blur of what is saturated can hardly be told apart: step less far.
            damping = max(10.0 * damping, FIRST_DAMPING)
            _go_back(best, p, equations)
        elif turn >= SETTLED - 1:
            lowest = cost
            damping *= 0.1
            _keep(best, p, equations)
        if not _solve(equations, damping):
            return False
        move = math.sqrt(step[COL] * step[COL] + step[ROW] * step[ROW])
        factor = _bold(p, step, move)
        for j in range(len(p)):
            p[j] += factor * step[j]
        # What is edge and what is flat is settled by the first step, unless that moves the edge by
        # so little that all that is edge has been taken for it already.
        sorting = turn == 0 and factor * _moved_edge(step, move, window.reach) > 0.2 * p[BLUR]
        _bound(p, levels, sign, below)
        if _lost(p, s_start, window):
            return False
        # The centre may be right before the grey levels are.
        settling = turn == 0 or changing
        if factor < 1.0 or worse or settling:
            continue
        if _has_settled(move, damping, equations, fitted.covariance):
            return _finish(fitted, damping, equations) and sign * (p[F0] - p[B0]) > 0.0
    return False
