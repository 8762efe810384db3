"""N, its right side and the cost, summed from blocks; each observation sees one row a group."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


def cost_of(problem: Problem, values: Values) -> float:
    """Return the weighted sum of squares; infinite where an observation cannot be predicted."""
    total = sum(_observed_group_cost(group, values) for group in problem.adjusted())
    for block in problem.blocks:
        residual = _residual(block, block.evaluate(values)[0])
        total += float(np.einsum("mi,mij,mj->", residual, block.weights(), residual))
    return total if np.isfinite(total) else float("inf")


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


def _add_block(
    normal: Array,
    right: Array,
    block: Block,
    residual: Array,
    weights: Array,
    derivatives: Mapping[str, Array],
    slices: Mapping[str, slice],
) -> None:
    weighted = {r: weights @ j for r, j in derivatives.items()}
    references = list(derivatives)
    for a in references:
        part = slices[group_of(a)]
        k = derivatives[a].shape[2]
        side = np.einsum("mdk,md->mk", weighted[a], residual)
        right[part] += _summed(side, block.index[a][:, None] * k + np.arange(k), part)
        for b in references:
            other = slices[group_of(b)]
            width = derivatives[b].shape[2]
            product = np.swapaxes(derivatives[a], 1, 2) @ weighted[b]
            _add_pairs(normal[part, other], product, block.index[a], block.index[b], width)


def _summed(values: Array, where: NDArray[np.integer], part: slice) -> Array:
    size = part.stop - part.start
    return np.asarray(np.bincount(where.ravel(), values.ravel(), minlength=size), dtype=float)


def _add_pairs(
    target: Array,
    product: Array,
    rows: NDArray[np.integer],
    columns: NDArray[np.integer],
    width: int,
) -> None:
    """Add (m, k, l) products to a view of N at the rows of their two groups."""
    k = product.shape[1]
    pair = np.asarray(rows, dtype=np.int64) * (target.shape[1] // width) + columns
    order = np.argsort(pair, kind="stable")
    pairs, starts = np.unique(pair[order], return_index=True)
    # What falls on the same place is summed first: += takes each place once.
    flat = product.reshape(len(product), -1)[order]
    product = np.add.reduceat(flat, starts, axis=0).reshape(-1, k, width)
    row, column = np.divmod(pairs, target.shape[1] // width)
    at_row = (row[:, None] * k + np.arange(k))[:, :, None]
    at_column = (column[:, None] * width + np.arange(width))[:, None, :]
    target[at_row, at_column] += product


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
