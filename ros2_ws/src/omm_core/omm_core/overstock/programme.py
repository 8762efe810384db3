"""The linear programmes of a fit: few unknowns, many rows, of which few matter.

Unknowns are a small motion y (K <= 6), the smallest margin t and the breach v of what must hold.
``maximise t - PENALTY v`` with a row for each point: ``value + J y >= t`` (it is to be raised) or
``value + J y >= -v`` (it must hold). Only rows near their limit are given to the solver; what
its answer breaks is added, until nothing is broken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, nnls

Array = NDArray[np.float64]
PENALTY = 1e4
FIRST_ROWS = 150
MORE_ROWS = 60
BROKEN_MM = 1e-9
_OPTIONS = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """What a programme answers.

    Attributes
    ----------
    step : (K,) array
        The motion.
    smallest_mm : float
        t, the smallest value that is to be raised.
    multipliers : (N,) array
        Of all rows; those to be raised sum to 1 where no bound of the step holds.
    """

    step: Array
    smallest_mm: float
    multipliers: Array


def raise_smallest(
    values: Array, jacobian: Array, raised: NDArray[np.bool_], radius: float
) -> Answer | None:
    """Return the step within +-radius that raises the smallest of the raised rows the most.

    Parameters
    ----------
    values : (N,) array
        Margin of the raised rows; how much is left of the others, which must stay >= 0.
    jacobian : (N, K) array
        Their derivatives.
    raised : (N,) array of bool
        Which rows are to be raised.
    radius : float
        Bound of each component of the step, mm.
    """
    chosen = _first(values, jacobian, raised, radius)
    while True:
        answer = _solve(values[chosen], jacobian[chosen], raised[chosen], radius)
        if answer is None:
            return None
        step, smallest, breach, weights = answer
        after = values + jacobian @ step - np.where(raised, smallest, -breach)
        after[chosen] = np.inf
        worst = np.argsort(after)[:MORE_ROWS]
        worst = worst[after[worst] < -BROKEN_MM]
        if len(worst) == 0:
            multipliers = np.zeros(len(values))
            multipliers[chosen] = weights
            return Answer(step=step, smallest_mm=smallest, multipliers=multipliers)
        chosen = np.concatenate([chosen, worst])


def _first(
    values: Array, jacobian: Array, raised: NDArray[np.bool_], radius: float
) -> NDArray[np.int64]:
    """Return rows to begin with: those that a step of this size can bring to their limit."""
    if len(values) <= FIRST_ROWS:
        return np.arange(len(values))
    level = np.where(raised, values - values[raised].min(), values)
    reach = np.minimum(radius, 10.0) * np.abs(jacobian).sum(axis=1)
    return np.sort(np.argsort(level - reach, kind="stable")[:FIRST_ROWS])


def _solve(
    values: Array, jacobian: Array, raised: NDArray[np.bool_], radius: float
) -> tuple[Array, float, float, Array] | None:
    count = jacobian.shape[1]
    shift = float(values[raised].min()) if raised.any() else 0.0
    level = np.where(raised, values - shift, values)
    columns = [-jacobian, raised[:, None].astype(float), -(~raised)[:, None].astype(float)]
    cost = np.zeros(count + 2)
    cost[count], cost[count + 1] = -1.0, PENALTY
    bounds: list[tuple[float | None, float | None]] = [(-radius, radius)] * count
    bounds += [(None, None) if raised.any() else (0.0, 0.0), (0.0, None)]
    answer = linprog(
        cost, A_ub=np.hstack(columns), b_ub=level, bounds=bounds, method="highs", options=_OPTIONS
    )
    if answer.x is None:
        return None
    x = answer.x
    return x[:count], float(x[count]) + shift, float(x[count + 1]), -answer.ineqlin.marginals


def nearest_allowed(rows: Array, wanted: Array, jacobian: Array, limit: Array) -> Array | None:
    """Return y with the least ``|rows y - wanted|²`` of those with ``jacobian y >= limit``.

    Lawson and Hanson's least-distance programme by non-negative least squares; rows (M, K) of
    full rank. None where nothing is allowed.
    """
    q, r = np.linalg.qr(rows)
    target = q.T @ wanted
    inverse = np.linalg.inv(r)
    turned = jacobian @ inverse
    left = limit - turned @ target
    chosen = np.argsort(-left, kind="stable")[:FIRST_ROWS]
    while True:
        z = _least_distance(turned[chosen], left[chosen])
        if z is None:
            return None
        after = turned @ z - left
        after[chosen] = np.inf
        worst = np.argsort(after)[:MORE_ROWS]
        worst = worst[after[worst] < -BROKEN_MM]
        if len(worst) == 0:
            return np.asarray(inverse @ (z + target))
        chosen = np.concatenate([chosen, worst])


def _least_distance(g: Array, h: Array) -> Array | None:
    """Return the shortest z with ``g z >= h``."""
    if (h <= 0.0).all():
        return np.zeros(g.shape[1])
    scale = float(np.abs(h).max())
    stacked = np.vstack([g.T, h[None] / scale])
    goal = np.zeros(len(stacked))
    goal[-1] = 1.0
    weights, _ = nnls(stacked, goal)
    rest = stacked @ weights - goal
    if -rest[-1] < 1e-12:
        return None
    return np.asarray(-rest[:-1] / rest[-1] * scale)
