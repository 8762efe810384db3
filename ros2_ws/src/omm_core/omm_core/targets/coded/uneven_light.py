"""The light around a ring from the sectors that are set.

Its logarithm is taken for a Gaussian process on the circle,

    log l(θ) = m(θ) + a + b·(cos θ, sin θ) + c·(cos 2θ, sin 2θ) + s(θ),

m what the dot shows, a, b, c normal with the standard deviations below, and s smooth over half a
radian. The set sectors' logarithms are its observations, and loosely the dot's side where the ring
is clear (Rasmussen and Williams, Gaussian
Processes for Machine Learning, 2006, eq. 2.23).
"""

from __future__ import annotations

import math

import numba
import numpy as np

from omm_core.numerics.linear_algebra import solve_damped

MIN_SET = 3
"""The light's level, its slope and its direction need three sectors."""
MAX_FALL = 3.3
"""Largest range of the logarithm around the ring: 27 times."""
MIN_FALL = 0.15
"""What falls less is evenly lit: then something else was against the ring."""
MAX_STRAIN = 2.5
"""Largest χ² per sector of what is found against what light does."""
_LEVEL, _SLOPE, _BEND, _SMOOTH, _LENGTH = 0.5, 0.7, 0.3, 0.3, 0.6
_OF_A_SECTOR, _OF_THE_DOT = 0.06, 0.8


@numba.njit(cache=True, error_model="numpy")
def _covariance(turn):
    """Of the logarithm at two places that far apart, rad."""
    near = math.atan2(math.sin(turn), math.cos(turn)) / _LENGTH
    return (
        _LEVEL**2
        + _SLOPE**2 * math.cos(turn)
        + _BEND**2 * math.cos(2.0 * turn)
        + _SMOOTH**2 * math.exp(-0.5 * near * near)
    )


@numba.njit(cache=True, error_model="numpy")
def light_around_ring(values, chosen, phase, dot, unit, light):
    """Fill the light (count,) around the ring.

    Parameters
    ----------
    values : (n,) brightness of the sectors, less what is clear there. chosen : (n,) which are set.
    phase : where the first begins, in samples. dot : (count,) brightness of the dot on a circle.
    unit : a grey value of 8 bit.

    Returns
    -------
    False where it cannot be told, or is none that light has.
    """
    n, count = len(values), len(dot)
    m = 0
    for b in range(n):
        m += 1 if chosen[b] else 0
    mean = _of_the_dot(dot, unit)
    if m < MIN_SET or m == n or math.isnan(mean[0]):
        return False
    at, rests, weights = np.empty(n), np.empty(n), np.empty(n)
    normal, work = np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        at[i] = 2.0 * math.pi * (phase / count + (i + 0.5) / n)
    for i in range(n):
        expected = mean[0] + mean[1] * math.cos(at[i]) + mean[2] * math.sin(at[i])
        seen, variance = values[i], _OF_A_SECTOR**2 + (0.5 * unit / values[i]) ** 2
        if not chosen[i]:
            # Where the ring is clear, the dot's side tells a little.
            seen, variance = dot[int(phase + (i + 0.5) * count / n) % count], _OF_THE_DOT**2
        rests[i] = expected - math.log(seen)
        for k in range(n):
            normal[i, k] = _covariance(at[i] - at[k])
        normal[i, i] += variance
    if not solve_damped(normal, rests, n, 0.0, work, weights):
        return False
    strain = 0.0
    for i in range(n):
        strain -= weights[i] * rests[i]
    if strain > MAX_STRAIN * n:
        return False
    lowest, highest = math.inf, -math.inf
    for k in range(count):
        angle = 2.0 * math.pi * (k + 0.5) / count
        value = mean[0] + mean[1] * math.cos(angle) + mean[2] * math.sin(angle)
        for i in range(n):
            value += weights[i] * _covariance(angle - at[i])
        lowest, highest = min(lowest, value), max(highest, value)
        light[k] = math.exp(value)
    return MIN_FALL < highest - lowest < MAX_FALL


@numba.njit(cache=True, error_model="numpy")
def _of_the_dot(dot, unit):
    """Mean logarithm and slope (3,) that the dot predicts at the ring; NaN where it is dark."""
    count = len(dot)
    mean = np.zeros(3)
    for i in range(count):
        if dot[i] < unit:
            mean[0] = math.nan
            return mean
        value, angle = math.log(dot[i]), 2.0 * math.pi * (i + 0.5) / count
        mean[0] += value / count
        mean[1] += 2.0 * value * math.cos(angle) / count
        mean[2] += 2.0 * value * math.sin(angle) / count
    return mean
