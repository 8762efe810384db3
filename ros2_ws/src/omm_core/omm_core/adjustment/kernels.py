"""What is summed over all observations, compiled."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def add_observations(
    normal: Array,
    right: Array,
    columns: NDArray[np.int64],
    jacobian: Array,
    weights: Array,
    residual: Array,
) -> None:
    """Add Jᵀ W J and Jᵀ W r of observations (m, d) to ``normal`` and ``right``.

    Parameters
    ----------
    normal, right : (U, U), (U,) arrays
        Changed in place.
    columns : (m, k) array
        The unknowns that each observation sees.
    jacobian, weights, residual : (m, d, k), (m, d, d), (m, d) arrays
    """
    m, d, k = jacobian.shape
    weighted = np.empty((d, k))
    for i in range(m):
        for e in range(d):
            for a in range(k):
                weighted[e, a] = 0.0
                for f in range(d):
                    weighted[e, a] += weights[i, e, f] * jacobian[i, f, a]
        for a in range(k):
            row = columns[i, a]
            for e in range(d):
                right[row] += weighted[e, a] * residual[i, e]
            for b in range(k):
                total = 0.0
                for e in range(d):
                    total += jacobian[i, e, a] * weighted[e, b]
                normal[row, columns[i, b]] += total


@numba.njit(cache=True, error_model="numpy")
def propagated(covariance: Array, columns: NDArray[np.int64], jacobian: Array) -> Array:
    """Return J Q Jᵀ of observations, (m, d, d).

    Parameters
    ----------
    covariance : (U, U) array
        Q, symmetric.
    columns : (m, k) array
        The unknowns that each observation sees.
    jacobian : (m, d, k) array
    """
    m, d, k = jacobian.shape
    known = np.zeros((m, d, d))
    for i in range(m):
        for a in range(k):
            for b in range(a + 1):
                share = covariance[columns[i, a], columns[i, b]]
                if a == b:
                    share *= 0.5
                for e in range(d):
                    for f in range(e + 1):
                        both = jacobian[i, e, a] * jacobian[i, f, b]
                        known[i, e, f] += share * (both + jacobian[i, e, b] * jacobian[i, f, a])
        for e in range(d):
            for f in range(e):
                known[i, f, e] = known[i, e, f]
    return known
