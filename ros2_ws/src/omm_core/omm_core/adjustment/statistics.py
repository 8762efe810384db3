"""What each observation contributes and whether it fits: redundancy numbers and w-tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment.kernels import propagated
from omm_core.adjustment.normal_equations import columns_of, jacobian_of
from omm_core.adjustment.problem import Block, Problem
from omm_core.adjustment.solving import Solution

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationTests:
    """Tests of one block's observations (Baarda 1968; Förstner 1979).

    Attributes
    ----------
    redundancy : (m, d) array
        Part of an error of each value that its residual shows, 0 to 1; their sum over all blocks
        and observed groups is the degrees of freedom.
    w : (m, d) array
        Standardised residual of each value, normal with sigma 1; 0 where nothing checks it.
    t2 : (m,) array
        The same for all d values of an observation at once: chi-square with d degrees of freedom.
    """

    redundancy: Array
    w: Array
    t2: Array


def test_observations(problem: Problem, solution: Solution) -> dict[str, ObservationTests]:
    """Return the tests of all observations, by block; sigma0 is taken as 1."""
    return {block.name: _block_tests(block, solution) for block in problem.blocks}


# Not a test of pytest's, where a test module imports it.
test_observations.__test__ = False  # type: ignore[attr-defined]


def _block_tests(block: Block, solution: Solution) -> ObservationTests:
    derivatives = solution.derivatives[block.name]
    residual = solution.residuals[block.name]
    known = predicted_covariance(block, derivatives, solution)
    weights = block.weights()
    identity = np.eye(residual.shape[1])
    redundancy = np.einsum("mii->mi", identity - known @ weights)
    # Covariance of W v: W - W A Q Aᵀ W.
    of_weighted = weights - weights @ known @ weights
    weighted = np.einsum("mij,mj->mi", weights, residual)
    variance = np.einsum("mii->mi", of_weighted)
    checked = variance > 1e-9 * np.einsum("mii->mi", weights)
    w = np.where(checked, weighted / np.sqrt(np.where(checked, variance, 1.0)), 0.0)
    t2 = np.einsum(
        "mi,mij,mj->m", weighted, np.linalg.pinv(of_weighted, rcond=1e-9, hermitian=True), weighted
    )
    return ObservationTests(redundancy=redundancy, w=w, t2=t2)


def predicted_covariance(block: Block, derivatives: dict[str, Array], solution: Solution) -> Array:
    """Return A Q Aᵀ of each observation, (m, d, d)."""
    m, d = block.observed.shape
    if not derivatives:
        return np.zeros((m, d, d))
    covariance = np.require(solution.covariance, np.float64, ("C", "W"))
    columns = columns_of(block, derivatives, solution.slices)
    return np.asarray(propagated(covariance, columns, jacobian_of(derivatives)))
