"""N, its right side and the cost, summed from blocks; each observation sees one row a group."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment.kernels import add_observations
from omm_core.adjustment.problem import Block, Group, Problem, Values

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearised:
    """A problem at given values.

    Attributes
    ----------
    normal : (U, U) array
    right : (U,) array
    residuals : mapping
        By block: observed minus predicted, (m, d).
    derivatives : mapping
        By block and reference, (m, d, k).
    cost : float
        Weighted sum of squares, observed groups included.
    """

    normal: Array
    right: Array
    residuals: dict[str, Array]
    derivatives: dict[str, dict[str, Array]]
    cost: float


def group_of(reference: str) -> str:
    """Return the group's name of a reference ``group`` or ``group:anything``."""
    return reference.split(":", 1)[0]


def linearise(problem: Problem, values: Values) -> Linearised:
    """Return the normal equations at given values."""
    slices = problem.slices()
    size = sum(group.values.size for group in problem.adjusted())
    normal, right = np.zeros((size, size)), np.zeros(size)
    residuals, derivatives = {}, {}
    cost = 0.0
    for block in problem.blocks:
        predicted, by_group = block.evaluate(values)
        residual = _residual(block, predicted)
        weights = block.weights()
        kept = {r: np.nan_to_num(j) for r, j in by_group.items() if group_of(r) in slices}
        _add_block(normal, right, block, residual, weights, kept, slices)
        residuals[block.name], derivatives[block.name] = residual, kept
        cost += float(np.einsum("mi,mij,mj->", residual, weights, residual))
    for group in problem.adjusted():
        _add_observed_group(normal, right, group, values, slices[group.name])
        cost += _observed_group_cost(group, values)
    return Linearised(
        normal=normal, right=right, residuals=residuals, derivatives=derivatives, cost=cost
    )


def _residual(block: Block, predicted: Array) -> Array:
    residual = np.asarray(block.observed - predicted)
    if block.used is not None:
        residual = np.where(block.used[:, None], residual, np.nan_to_num(residual))
    return residual


def columns_of(
    block: Block, derivatives: Mapping[str, Array], slices: Mapping[str, slice]
) -> NDArray[np.int64]:
    """Return which unknowns each observation sees, (m, k), in the order of its derivatives."""
    columns = [np.zeros((len(block.observed), 0), dtype=np.int64)]
    for reference, derivative in derivatives.items():
        k = derivative.shape[2]
        start = slices[group_of(reference)].start
        columns.append(start + np.asarray(block.index[reference])[:, None] * k + np.arange(k))
    return np.require(np.concatenate(columns, axis=1), np.int64, "C")


def jacobian_of(derivatives: Mapping[str, Array]) -> Array:
    """Return the derivatives (m, d, k) side by side, as they lie in `columns_of`."""
    return np.require(np.concatenate(list(derivatives.values()), axis=2), np.float64, "C")


def _add_block(
    normal: Array,
    right: Array,
    block: Block,
    residual: Array,
    weights: Array,
    derivatives: Mapping[str, Array],
    slices: Mapping[str, slice],
) -> None:
    if derivatives:
        columns, jacobian = columns_of(block, derivatives, slices), jacobian_of(derivatives)
        residual = np.require(residual, np.float64, ("C", "W"))
        add_observations(normal, right, columns, jacobian, weights, residual)


def _add_observed_group(
    normal: Array, right: Array, group: Group, values: Values, part: slice
) -> None:
    weight = group.weight()
    if weight is None:
        return
    difference = group.target() - values[group.name].ravel()
    if weight.ndim == 1:
        normal[part, part] += np.diag(weight)
        right[part] += weight * difference
    else:
        normal[part, part] += weight
        right[part] += weight @ difference


def _observed_group_cost(group: Group, values: Values) -> float:
    weight = group.weight()
    if weight is None:
        return 0.0
    difference = group.target() - values[group.name].ravel()
    return float(difference @ (weight * difference if weight.ndim == 1 else weight @ difference))
