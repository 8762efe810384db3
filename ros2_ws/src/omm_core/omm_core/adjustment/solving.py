"""Gauss-Newton on dense, scaled normal equations, with what they cannot tell found by algebra."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from omm_core.adjustment.normal_equations import Linearised, linearise
from omm_core.adjustment.parting import Parted, apart, inverted
from omm_core.adjustment.problem import Problem, Values

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Smallest eigenvalue of the scaled normal matrix (unit diagonal) that counts as information:
# what is left of an exactly undetermined direction after rounding lies below 1e-12.
UNDETERMINED = 1e-11
_DAMPING_STEPS = 14
_NOWHERE = 1e100  # of no unknown's unit: the equations are singular, but for rounding
# Added to the scaled diagonal: rounding does not carry undetermined directions away.
_LOST = 1e-11


@dataclass(frozen=True, kw_only=True, eq=False)
class Undetermined:
    """A direction among the unknowns about which nothing is known.

    Attributes
    ----------
    direction : (U,) array
        In the units of the unknowns; the largest scaled part is 1 of its own sigma.
    labels : tuple of str
        Unknowns that take part, the strongest first.
    """

    direction: Array
    labels: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """What came out.

    Attributes
    ----------
    values : mapping
        By group, (n, k); fixed groups included.
    covariance : (U, U) array
        Of all adjusted unknowns, a priori (sigma0 = 1); zero for held ones.
    slices : mapping
        Where each adjusted group stands in it.
    residuals : mapping
        By block: observed minus predicted, (m, d).
    cost, degrees_of_freedom, sigma0 : float, int, float
        sigma0 is NaN without redundancy.
    undetermined : tuple of Undetermined
    """

    values: dict[str, Array]
    covariance: Array
    slices: dict[str, slice]
    residuals: dict[str, Array]
    derivatives: dict[str, dict[str, Array]]
    cost: float
    degrees_of_freedom: int
    sigma0: float
    iterations: int
    converged: bool
    undetermined: tuple[Undetermined, ...] = ()

    def covariance_of(self, group: str) -> Array:
        """Return the covariance (n k, n k) of one group."""
        part = self.slices[group]
        return self.covariance[part, part]


def solve(
    problem: Problem, *, iterations: int = 50, tolerance: float = 1e-5, undetermined: bool = True
) -> Solution:
    """Adjust.

    Parameters
    ----------
    problem : Problem
    iterations : int
        At most.
    tolerance : float
        Ends when a step moves the result by less than this many sigma in any direction.
    undetermined : bool
        Whether to look for undetermined directions; without, they raise LinAlgError.
    """
    values: dict[str, Array] = {group.name: np.array(group.values) for group in problem.groups}
    free, datum, parting = problem.free(), problem.datum_matrix(), apart(problem)
    converged, count = False, 0
    at = linearise(problem, values)
    while count < iterations and not converged:
        count += 1
        system = _Scaled(at, free, datum, parting)
        values, at, moved = _improve(problem, values, at, system, free)
        converged = moved < tolerance
    system = _Scaled(at, free, datum, parting)
    covariance, directions = system.covariance(look=undetermined)
    if not free.all():
        known, covariance = covariance, np.zeros((len(free), len(free)))
        covariance[np.ix_(free, free)] = known
    unknowns = int(free.sum()) - datum.shape[1] - len(directions)
    degrees = _observations(problem) - unknowns
    return Solution(
        values=values,
        covariance=covariance,
        slices=problem.slices(),
        residuals=at.residuals,
        derivatives=at.derivatives,
        cost=at.cost,
        degrees_of_freedom=degrees,
        sigma0=float(np.sqrt(at.cost / degrees)) if degrees > 0 else float("nan"),
        iterations=count,
        converged=converged,
        undetermined=tuple(_named(problem, free, d, system.scale) for d in directions),
    )


class _Scaled:
    """The normal equations of the free unknowns, scaled to a unit diagonal."""

    def __init__(
        self, at: Linearised, free: Mask, datum: Array, parting: tuple[slice, int] | None
    ) -> None:
        diagonal = np.diag(at.normal)[free]
        self.scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
        self.right = at.right[free] * self.scale
        # Only the space that G spans matters, so its columns may be made orthonormal.
        self.datum = np.linalg.qr(datum[free] * self.scale[:, None])[0] if datum.size else None
        self.normal, self.free = at.normal, free
        self.parted = (
            None if parting is None else Parted(at.normal, free, self.scale, self.datum, parting)
        )

    @cached_property
    def matrix(self) -> Array:
        """Return the whole matrix, datum included."""
        every = self.free.all()
        picked = self.normal if every else self.normal[np.ix_(self.free, self.free)]
        matrix = np.asarray(picked * self.scale[:, None])
        matrix *= self.scale
        if self.datum is not None:
            matrix += self.datum @ self.datum.T
        return matrix

    def step(self, damping: float) -> Array:
        """Return the step in the unknowns' own units."""
        if self.parted is not None:
            parts = self.parted.step(self.right, damping + _LOST)
            if parts is not None:
                return np.asarray(self.scale * parts)
        matrix = self._copied(damping + _LOST)
        _, found, failed = dposv(matrix, self.right, lower=1, overwrite_a=1)
        if failed:  # not positive definite, by rounding
            found = np.linalg.solve(self._copied(damping + _LOST), self.right)
        return np.asarray(self.scale * found.ravel())

    def _copied(self, added: float) -> Array:
        """Return a copy in LAPACK's order (the matrix is symmetric), with more on its diagonal."""
        matrix = self.matrix.copy().T
        np.einsum("ii->i", matrix)[...] += added
        return matrix

    def covariance(self, *, look: bool) -> tuple[Array, list[Array]]:
        """Return the covariance and the undetermined directions, in the unknowns' own units."""
        directions: list[Array] = []
        if not len(self.scale):
            return np.zeros((0, 0)), directions
        inverse = None if self.parted is None else self.parted.inverse()
        if inverse is None:
            inverse = inverted(self._copied(0.0))
        if inverse is None and not look:
            raise np.linalg.LinAlgError("The normal equations are not positive definite.")
        if inverse is None:
            inverse = np.full_like(self.matrix, np.inf)
        if look and np.abs(np.diag(inverse)).max() > 0.01 / UNDETERMINED:
            values, vectors = np.linalg.eigh(self.matrix)
            lost = values < UNDETERMINED
            directions = [vectors[:, i] * self.scale for i in np.flatnonzero(lost)]
            inverse = (vectors[:, ~lost] / values[~lost]) @ vectors[:, ~lost].T
        if self.datum is not None:  # (N + G Gᵀ)⁻¹ less the part that the datum made up
            made_up = inverse @ self.datum
            inverse -= made_up @ made_up.T
        inverse *= self.scale[:, None]
        inverse *= self.scale
        return inverse, directions


def _improve(
    problem: Problem, values: dict[str, Array], at: Linearised, system: _Scaled, free: Mask
) -> tuple[dict[str, Array], Linearised, float]:
    """Take the step that lowers the cost; damp it until it does."""
    damping = 0.0
    for _ in range(_DAMPING_STEPS):
        step = system.step(damping)
        if not np.abs(step).max(initial=0.0) < _NOWHERE:
            damping = max(10.0 * damping, 1e-4)
            continue
        # The squared way in sigmas is what the step promises the cost to fall by.
        moved = float(np.sqrt(max(float(step @ (system.right / system.scale)), 0.0)))
        tried = _moved(problem, values, step, free)
        there = linearise(problem, tried)
        if there.cost <= at.cost * (1.0 + 1e-12) + 1e-12:
            return tried, there, moved
        if moved < 1e-3 and np.isfinite(there.cost):  # rounding: there is nothing left to gain
            return values, at, 0.0
        damping = max(10.0 * damping, 1e-4)
    return values, at, float("inf")


def _moved(problem: Problem, values: Values, step: Array, free: Mask) -> dict[str, Array]:
    whole = np.zeros(len(free))
    whole[free] = step
    moved = dict(values)
    for group in problem.adjusted():
        part = whole[problem.slices()[group.name]].reshape(group.values.shape)
        old = values[group.name]
        moved[group.name] = old + part if group.update is None else group.update(old, part)
    return moved


def _observations(problem: Problem) -> int:
    count = 0
    for block in problem.blocks:
        m, d = np.shape(block.observed)
        count += d * (m if block.used is None else int(block.used.sum()))
    for group in problem.adjusted():
        weight = group.weight()
        if weight is not None:
            count += int((weight > 0).sum()) if weight.ndim == 1 else len(weight)
    return count


def _named(problem: Problem, free: Mask, direction: Array, scale: Array) -> Undetermined:
    whole, scaled = np.zeros(len(free)), np.zeros(len(free))
    whole[free], scaled[free] = direction, np.abs(direction / scale)
    labels = problem.labels()
    order = [i for i in np.argsort(-scaled) if scaled[i] > 0.05 * scaled.max()]
    return Undetermined(direction=whole, labels=tuple(labels[i] for i in order))
