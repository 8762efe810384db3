"""Small symmetric systems, compiled: what finding, centring and solving share.

numba's own np.linalg hands every matrix to LAPACK and takes seconds to compile for each caller.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_FASTMATH = {"contract", "reassoc", "arcp", "nsz"}
_SMALLEST_PIVOT = 1e-15
"""Share of a diagonal element that must be left of it: below, the rest is rounding."""


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH)
def solve_damped(N, g, size, damping, L, step):
    """Fill step = -(N + damping diag N)⁻¹ g by Cholesky; False where not definite.

    L (size, size) is room to work in; it comes out with the inverse of its diagonal.
    """
    for j in range(size):
        value = N[j, j] * (1.0 + damping)
        for k in range(j):
            value -= L[j, k] * L[j, k]
        if not value > _SMALLEST_PIVOT * N[j, j]:
            return False
        inverse = 1.0 / math.sqrt(value)
        L[j, j] = inverse
        step_j = -g[j]
        for k in range(j):
            step_j -= L[j, k] * step[k]
        step[j] = step_j * inverse
        for i in range(j + 1, size):
            value = N[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            L[i, j] = value * inverse
    for i in range(size - 1, -1, -1):
        value = step[i] * L[i, i]
        step[i] = value
        for k in range(i):
            step[k] -= L[i, k] * value
    return True


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH)
def invert(N, inverse):
    """Fill the inverse of a positive definite matrix (u, u), symmetric; False where it is not.

    Only the lower triangle of N is read.
    """
    u = N.shape[0]
    L = np.empty((u, u))  # of N = L Lᵀ, then its inverse
    for j in range(u):
        value = N[j, j]
        for k in range(j):
            value -= L[j, k] * L[j, k]
        if not value > _SMALLEST_PIVOT * N[j, j]:
            return False
        L[j, j] = 1.0 / math.sqrt(value)
        for i in range(j + 1, u):
            value = N[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            L[i, j] = value * L[j, j]
    for j in range(u):
        for i in range(j + 1, u):
            value = 0.0
            for k in range(j, i):
                value -= L[i, k] * L[k, j]
            L[i, j] = value * L[i, i]
    for i in range(u):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, u):
                value += L[k, i] * L[k, j]
            inverse[i, j] = inverse[j, i] = value
    return True


@njit(cache=True, fastmath=True)
def product(a, b, count):
    """Return the sum of a_i b_i over the first `count`; in vectors, so in no certain order."""
    total = 0.0
    for i in range(count):
        total += a[i] * b[i]
    return total


@njit(cache=True)
def copy_to(target, source):
    """Copy a matrix (``target[:] = source``), without numba's checks.

    Their compilation alone takes five seconds.
    """
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


def inverse(N):
    """Return the inverse of a positive definite matrix (u, u), symmetric; NaN where it is not."""
    inverted = np.empty(N.shape)
    if not invert(np.ascontiguousarray(N, dtype=float), inverted):
        inverted[:] = np.nan
    return inverted
