"""What the noise model is made of: a problem's rows split, smooth errors' covariance; compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from omm_core.imaging.kernels import FASTMATH

_compiled = njit(cache=True, error_model="numpy", fastmath=FASTMATH)
_NO_RANK = 1e-9  # of a column of length 1: what is left of it without those before


@_compiled
def split_rows(design, split):
    """Fill (P, K) of a design (n, u): P A = 1, K A = 0, K Kᵀ = 1; False where A has no rank.

    Householder's A = Q R: K are the last rows of Qᵀ, and P is R⁻¹ times the first.
    """
    n, u = design.shape
    A, v = np.empty((n, u)), np.empty(n)
    scale = np.empty(u)
    for j in range(u):
        length2 = 0.0
        for i in range(n):
            length2 += design[i, j] * design[i, j]
        if not length2 > 0.0:
            return False
        scale[j] = 1.0 / math.sqrt(length2)
        for i in range(n):
            A[i, j] = design[i, j] * scale[j]
    for i in range(n):
        for j in range(n):
            split[i, j] = 1.0 if i == j else 0.0
    for j in range(u):
        length2 = 0.0
        for i in range(j, n):
            length2 += A[i, j] * A[i, j]
        length = math.sqrt(length2)
        if length < _NO_RANK:
            return False
        head = A[j, j] + (length if A[j, j] > 0.0 else -length)
        v2 = length2 - A[j, j] * A[j, j] + head * head
        v[j] = head
        for i in range(j + 1, n):
            v[i] = A[i, j]
        for k in range(j, u):
            value = 0.0
            for i in range(j, n):
                value += v[i] * A[i, k]
            value *= 2.0 / v2
            for i in range(j, n):
                A[i, k] -= value * v[i]
        for k in range(n):
            value = 0.0
            for i in range(j, n):
                value += v[i] * split[i, k]
            value *= 2.0 / v2
            for i in range(j, n):
                split[i, k] -= value * v[i]
    for i in range(u - 1, -1, -1):
        for k in range(n):
            value = split[i, k]
            for j in range(i + 1, u):
                value -= A[i, j] * split[j, k]
            split[i, k] = value / A[i, i]
    for i in range(u):
        for k in range(n):
            split[i, k] *= scale[i]
    return True


@_compiled
def smooth_covariance(effect, places, lengths, covariance):
    """Fill E (k ⊗ 1) Eᵀ for each length, (L, r, r), with k = exp(-d² / 2 length²).

    ``effect`` (r, S, 3) is E: what errors at the stops do; ``places`` (S, 3) where these are.
    """
    rows, count = effect.shape[0], effect.shape[1]
    kernel, spread = np.empty((count, count)), np.empty((count, 3))
    for index in range(lengths.size):
        scale = -0.5 / (lengths[index] * lengths[index])
        for i in range(count):
            for j in range(i + 1):
                apart2 = 0.0
                for axis in range(3):
                    apart2 += (places[i, axis] - places[j, axis]) ** 2
                kernel[i, j] = kernel[j, i] = math.exp(scale * apart2)
        for r in range(rows):
            for i in range(count):
                x = y = z = 0.0
                for j in range(count):
                    x += kernel[i, j] * effect[r, j, 0]
                    y += kernel[i, j] * effect[r, j, 1]
                    z += kernel[i, j] * effect[r, j, 2]
                spread[i, 0], spread[i, 1], spread[i, 2] = x, y, z
            for s in range(r + 1):
                value = 0.0
                for i in range(count):
                    for axis in range(3):
                        value += spread[i, axis] * effect[s, i, axis]
                covariance[index, r, s] = covariance[index, s, r] = value
