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

from omm_core.numerics.linear_algebra import copy_to, product
from omm_core.targets.conic.dot_equations import (
    SETTLED,
    centre_covariance,
    look,
    rooms,
    set_equations,
    solve,
)
from omm_core.targets.conic.dot_model import (
    B0,
    BLUR,
    CHI2,
    CLEAR_PIXELS,
    CLEAR_SQUARES,
    F0,
    PARAMETERS,
    PIXELS,
    SET_PIXELS,
    SET_SQUARES,
    Floats,
    sort_pixels,
    window_of,
)
from omm_core.targets.conic.outline import COL, LEVEL_IN, LEVEL_OUT, ROW, WIDTH, XX, XY, YY

MAX_TURNS = 25
FIRST_DAMPING = 0.1


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
    centre_covariance(equations, covariance)
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
        converged = solve(equations, 0.0)
        centre_covariance(equations, fitted.covariance)
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
    room, equations, best = rooms((1.0 + 0.6 * (ring.inner - 1.0)) * window.reach)
    step = equations.step
    lowest, damping = math.inf, 0.0
    used = np.int64(0)
    sorting = True
    for turn in range(MAX_TURNS):
        if sorting:
            used = sort_pixels(image, start, p, ring.inner, below, room.pixels, room.flat)
        changing = look(p, used, turn, window, ring, noise, room, fitted.statistics)
        cost = set_equations(fitted, used, levels, noise, light, room, equations)
        worse = turn >= SETTLED and cost > lowest * (1.0 + 1e-9)
        if worse:
            # Level, size and blur of what is saturated can hardly be told apart: step less far.
            damping = max(10.0 * damping, FIRST_DAMPING)
            _go_back(best, p, equations)
        elif turn >= SETTLED - 1:
            lowest = cost
            damping *= 0.1
            _keep(best, p, equations)
        if not solve(equations, damping):
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
