"""A budget evaluated: what each contributor makes at each point, and all of them together.

Everything is linear in the inputs here (a part is turned by angles whose errors are 1e-4 and
smaller), so that a contributor is one number with a distribution, times millimetres at each point
and axis: ``error[point, axis] = Σ_i millimetres_i[point, axis] z_i`` with z_i of standard
uncertainty 1. GUM eq. 13 (correlation), eq. G.2b (degrees of freedom); JCGM 101, 7.9 (as many
trials as the result needs) and 8.1 (do the two agree).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.distributions import Distribution
from omm_core.budget.propagation import (
    Correlation,
    correlation_matrix,
    draw,
    student_factor,
    tolerance_of,
)

Array = NDArray[np.float64]

# What k = 2 holds of a normal distribution, and what the contract's U means.
PROBABILITY = math.erf(math.sqrt(2.0))
_BLOCK, _MOST_BLOCKS = 200_000, 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Contribution:
    """One contributor at all points.

    Attributes
    ----------
    name : str
    group : str
        u_ip, u_it, u_out, u_machine or other: the columns of the table.
    millimetres : (P, 3) array
        Sensitivity times standard uncertainty along machine X Y Z; with its sign.
    shape : Distribution
        Of unit standard uncertainty.
    freedom : (P, 3) array or None
        Degrees of freedom where they differ from point to point (a campaign's); else the shape's.
    """

    name: str
    group: str
    millimetres: Array
    shape: Distribution
    freedom: Array | None = None

    def degrees_of_freedom(self) -> Array:
        """Return the degrees of freedom at each point and axis, (P, 3)."""
        if self.freedom is not None:
            return self.freedom
        return np.full(self.millimetres.shape, self.shape.degrees_of_freedom)


@dataclass(frozen=True, kw_only=True, eq=False)
class Combined:
    """All contributors together at all points.

    Attributes
    ----------
    standard_uncertainty_mm : (P, 3) array
    degrees_of_freedom : (P, 3) array
        Effective, infinite where all spreads are exactly known.
    shares : dict
        By contribution, (P, 3): part of the variance; they sum to 1 (correlation counts half to
        each of the two).
    """

    standard_uncertainty_mm: Array
    degrees_of_freedom: Array
    shares: dict[str, Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Sampled:
    """What Monte Carlo says: half width of the interval with equal tails, and whether GUM agrees.

    ``first_order_mm`` is the GUM's half width that it is compared with; ``sigma_mm`` the standard
    deviation of ``half_width_mm`` from one seed to another.
    """

    half_width_mm: Array
    first_order_mm: Array
    agrees: NDArray[np.bool_]
    sigma_mm: Array
    trials: int


def standard(kind: str, degrees_of_freedom: float = math.inf) -> Distribution:
    """Return a distribution of unit standard uncertainty."""
    return Distribution(kind=kind, standard_uncertainty=1.0, degrees_of_freedom=degrees_of_freedom)


def root_sum_squares(contributions: Sequence[Contribution], *groups: str) -> Array:
    """Return √ of the sum of squares of the contributions of some groups, (P, 3)."""
    shape = contributions[0].millimetres.shape
    squares = [c.millimetres**2 for c in contributions if c.group in groups]
    return np.sqrt(np.sum(squares, axis=0)) if squares else np.zeros(shape)


def combine(contributions: Sequence[Contribution], correlation: Correlation) -> Combined:
    """Combine by the GUM's law of propagation."""
    names = [c.name for c in contributions]
    matrix = correlation_matrix(names, correlation)
    each = np.array([c.millimetres for c in contributions])
    crossed = np.einsum("ipa,ij,jpa->ipa", each, matrix, each)
    variance = np.clip(crossed.sum(axis=0), 0.0, None)
    safe = np.where(variance > 0.0, variance, 1.0)
    return Combined(
        standard_uncertainty_mm=np.sqrt(variance),
        degrees_of_freedom=_welch_satterthwaite(contributions, matrix, crossed, variance),
        shares={name: share / safe for name, share in zip(names, crossed)},
    )


def sample(
    contributions: Sequence[Contribution],
    correlation: Correlation,
    combined: Combined,
    *,
    by_degrees_of_freedom: bool = False,
    seed: int = 1,
) -> Sampled:
    """Propagate the distributions until the result is sharp enough to be compared (JCGM 101, 7.9).

    Parameters
    ----------
    by_degrees_of_freedom : bool
        Compare with the GUM's interval by Student's factor instead of k = 2.
    """
    points = combined.standard_uncertainty_mm.shape[0]
    u = combined.standard_uncertainty_mm.reshape(-1)
    delta = np.array([tolerance_of(value) for value in u])
    ends = _ends(contributions, correlation, delta, np.random.default_rng(seed))
    low, high = np.mean(ends, axis=0).T
    factor = np.full(len(u), 2.0)
    if by_degrees_of_freedom:
        freedom = combined.degrees_of_freedom.reshape(-1)
        factor = np.array([student_factor(PROBABILITY, value) for value in freedom])
    # Contributors that cancel leave rounding alone: of that, neither is right.
    delta = np.maximum(
        delta, 1e-9 * np.sum([np.abs(c.millimetres) for c in contributions], 0).ravel()
    )
    halves = np.array([(end[:, 1] - end[:, 0]) / 2 for end in ends])
    sigma = halves.std(axis=0, ddof=1) / math.sqrt(len(ends))
    # All distributions lie evenly about 0: both ends are off by the same, but for the draw.
    off = np.abs((high - low) / 2 - factor * u)
    return Sampled(
        half_width_mm=((high - low) / 2).reshape(points, 3),
        first_order_mm=(factor * u).reshape(points, 3),
        # What the draw alone can make is no disagreement (4 uniform ones: off by 0.992 δ).
        agrees=(off <= delta + 2.0 * sigma).reshape(points, 3),
        sigma_mm=sigma.reshape(points, 3),
        trials=len(ends) * _BLOCK,
    )


def _ends(
    contributions: Sequence[Contribution],
    correlation: Correlation,
    delta: Array,
    random: np.random.Generator,
) -> list[Array]:
    """Return the interval's ends at each point and axis, (3P, 2), of as many blocks as it needs."""
    # What has other degrees of freedom at each point is drawn for each of them.
    own = [c for c in contributions if c.freedom is not None]
    shared = [c for c in contributions if c.freedom is None]
    names = [c.name for c in shared]
    known = {pair: r for pair, r in correlation.items() if set(pair) <= set(names)}
    matrix = correlation_matrix(names, known)
    shapes = [c.shape for c in shared]
    each = np.array([c.millimetres.reshape(-1) for c in shared]).reshape(len(shared), len(delta))
    tails = [round((0.5 + side * PROBABILITY / 2) * (_BLOCK - 1)) for side in (-1, 1)]
    ends: list[Array] = []
    while len(ends) < _MOST_BLOCKS:
        errors = each.T @ draw(shapes, matrix, random, _BLOCK)
        for one in own:
            # numpy's Student knows no infinity.
            degrees = np.minimum(one.degrees_of_freedom(), 1e9).reshape(-1, 1)
            spread = one.millimetres.reshape(-1, 1)
            errors += spread * random.standard_t(degrees, (len(spread), _BLOCK))
        errors.partition(tails, axis=1)
        ends.append(errors[:, tails])
        if len(ends) >= 4 and np.all(_spread(ends) <= delta[:, None] / 5.0):
            break
    return ends


def _spread(ends: list[Array]) -> Array:
    """Return twice the standard deviation of the mean of the interval's ends (7.9.4 f)."""
    return np.asarray(2.0 * np.std(ends, axis=0, ddof=1) / math.sqrt(len(ends)))


def _welch_satterthwaite(
    contributions: Sequence[Contribution], matrix: Array, crossed: Array, variance: Array
) -> Array:
    """Return ν_eff = u⁴ / Σ u_g⁴ / ν_g; correlated contributions count as one group g.

    The GUM's formula holds for independent ones only (G.4.1). A group's degrees of freedom are the
    smallest of its members': never more than is known.
    """
    needed = np.zeros_like(variance)
    for group in _groups(matrix):
        freedom = np.min([contributions[i].degrees_of_freedom() for i in group], axis=0)
        needed += crossed[group].sum(axis=0) ** 2 / freedom
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(needed > 0.0, variance**2 / np.where(needed > 0, needed, 1.0), np.inf)


def _groups(matrix: Array) -> list[list[int]]:
    from scipy.sparse.csgraph import connected_components

    count, label = connected_components(matrix != 0.0, directed=False)
    return [list(np.flatnonzero(label == group)) for group in range(count)]
