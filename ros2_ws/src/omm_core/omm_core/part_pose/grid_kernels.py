"""The posterior of the machine's noise and of the pose, compiled.

``y = A δ + n`` is a problem made linear about its optimum (noise_model.py). With P A = 1 and
K A = 0, ``u = P y`` and ``z = K y`` hold what the data say: z has no part of δ in it and tells of
the noise alone. A machine g gives the noise the covariance

    C_g = C_0 + κ² C_image + σ_stop² C_stop + σ_geometry² C_l,

each matrix (u + m, u + m) in the order (u, z). Its probability is ∝ prior · N(z; 0, C_zz), and
the pose that it would mean is ``u - C_uz C_zz⁻¹ z`` with covariance ``C_uu - C_uz C_zz⁻¹ C_zu``:
generalised least squares. Two statements (own and absolute coordinates) differ in C_uu and C_uz of
the geometry only, so that both come from one factor of C_zz.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from omm_core.imaging.kernels import FASTMATH
from omm_core.part_pose.mixture_kernels import normalise

Array = NDArray[np.float64]

_compiled = njit(cache=True, error_model="numpy", fastmath=FASTMATH)


class Matrices(NamedTuple):
    """C_0, C_image and C_stop (n, n), C_own and C_absolute (L, n, n) by length.

    The zz blocks of the last two are the same.
    """

    C_0: Array
    C_image: Array
    C_stop: Array
    C_own: Array
    C_absolute: Array


class NoiseBlocks(NamedTuple):
    """The zz blocks of :class:`Matrices`."""

    C_0: Array
    C_image: Array
    C_stop: Array
    C_geometry: Array


class Machines(NamedTuple):
    """The grid: κ, σ_stop, σ_geometry, which length l, ln prior, (P,) each."""

    scales: Array
    stops: Array
    geometry: Array
    lengths: NDArray[np.int64]
    log_prior: Array


class Weighed(NamedTuple):
    """What :func:`weigh` fills.

    Attributes
    ----------
    log_weight, fit : (P,)
        ln(prior · likelihood) and zᵀ C_zz⁻¹ z.
    deltas, covariances : (P, 2, u), (P, 2, u, u)
        Own, absolute.
    """

    log_weight: Array
    fit: Array
    deltas: Array
    covariances: Array


@_compiled
def _factor(C, m, L):
    """Fill the lower Cholesky factor of C (m, m), 1/diagonal on its diagonal; return ln |C|."""
    log_determinant = 0.0
    for j in range(m):
        value = C[j, j]
        for k in range(j):
            value -= L[j, k] * L[j, k]
        if not value > 0.0:
            return np.inf
        log_determinant += math.log(value)
        inverse = 1.0 / math.sqrt(value)
        L[j, j] = inverse
        for i in range(j + 1, m):
            value = C[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            L[i, j] = value * inverse
    return log_determinant


@_compiled
def _forward(L, m, row):
    """Replace ``row`` (m,) by L⁻¹ row."""
    for i in range(m):
        value = row[i]
        for k in range(i):
            value -= L[i, k] * row[k]
        row[i] = value * L[i, i]


@_compiled
def _whiten(L, X, square):
    """Replace X (m, w) by L⁻¹ X, all columns at once, and fill XᵀX of that."""
    m, width = X.shape
    for i in range(m):
        for k in range(i):
            factor = L[i, k]
            for j in range(width):
                X[i, j] -= factor * X[k, j]
        factor = L[i, i]
        for j in range(width):
            X[i, j] *= factor
    square[:, :] = 0.0
    for i in range(m):
        for k in range(width):
            factor = X[i, k]
            for j in range(width):
                square[k, j] += factor * X[i, j]


@_compiled
def weigh(matrices, u_z, u, machines, weighed):
    """Fill what each machine of the grid means.

    Parameters
    ----------
    matrices : Matrices
    u_z : (n,)
        (u, z) of the data.
    u : int
        Number of unknowns; m = n - u.
    machines : Machines
    weighed : Weighed
        Filled.
    """
    C_0, C_image, C_stop, C_own, C_absolute = matrices
    scales, stops, geometry, lengths, log_prior = machines
    log_weight, fit, deltas, covariances = weighed
    n = C_0.shape[0]
    m, width = n - u, 2 * u + 1
    C, L = np.empty((m, m)), np.empty((m, m))
    X = np.empty((m, width))  # C_zu of own and of absolute coordinates, and z; then L⁻¹ of them
    square = np.empty((width, width))
    for p in range(stops.size):
        a, b, c = scales[p] * scales[p], stops[p] * stops[p], geometry[p] * geometry[p]
        G_own, G_absolute = C_own[lengths[p]], C_absolute[lengths[p]]
        for i in range(m):
            for j in range(i + 1):
                C[i, j] = (
                    C_0[u + i, u + j] + a * C_image[u + i, u + j] + b * C_stop[u + i, u + j]
                    + c * G_own[u + i, u + j]
                )  # fmt: skip
            for k in range(u):
                common = C_0[u + i, k] + a * C_image[u + i, k] + b * C_stop[u + i, k]
                X[i, k] = common + c * G_own[u + i, k]
                X[i, u + k] = common + c * G_absolute[u + i, k]
            X[i, 2 * u] = u_z[u + i]
        log_determinant = _factor(C, m, L)
        _whiten(L, X, square)
        fit[p] = square[2 * u, 2 * u]
        log_weight[p] = log_prior[p] - 0.5 * (fit[p] + log_determinant)
        for which in range(2):
            G, at = (G_own, 0) if which == 0 else (G_absolute, u)
            for k in range(u):
                deltas[p, which, k] = u_z[k] - square[at + k, 2 * u]
                for j in range(u):
                    covariances[p, which, k, j] = (
                        C_0[k, j] + a * C_image[k, j] + b * C_stop[k, j] + c * G[k, j]
                        - square[at + k, at + j]
                    )  # fmt: skip


@_compiled
def bayes_factors(blocks, z, machines, columns, first, log_factors):
    """Fill ln(evidence with / evidence without) of hypotheses "these rows are wrong, too".

    A hypothesis adds E Eᵀ to C_zz, with E its columns (m, k) of ``columns``: from ``first[h]`` to
    ``first[h + 1]``. ``blocks`` are :class:`NoiseBlocks`; ``columns`` (c, m) holds E transposed.
    """
    C_0, C_image, C_stop, C_geometry = blocks
    scales, stops, geometry, lengths, log_prior = machines
    m, count = z.size, first.size - 1
    widest = 0
    for h in range(count):
        widest = max(widest, first[h + 1] - first[h])
    C, L = np.empty((m, m)), np.empty((m, m))
    rows, z_white = np.empty(columns.shape), np.empty(m)
    M, M_factor, b = np.empty((widest, widest)), np.empty((widest, widest)), np.empty(widest)
    log_weight, weight = np.empty(stops.size), np.empty(stops.size)
    gains = np.empty((count, stops.size))
    for p in range(stops.size):
        s, t, c = scales[p] * scales[p], stops[p] * stops[p], geometry[p] * geometry[p]
        G = C_geometry[lengths[p]]
        for i in range(m):
            for j in range(i + 1):
                C[i, j] = C_0[i, j] + s * C_image[i, j] + t * C_stop[i, j] + c * G[i, j]
            z_white[i] = z[i]
        log_determinant = _factor(C, m, L)
        _forward(L, m, z_white)
        square = 0.0
        for i in range(m):
            square += z_white[i] * z_white[i]
        log_weight[p] = log_prior[p] - 0.5 * (square + log_determinant)
        for q in range(columns.shape[0]):
            for i in range(m):
                rows[q, i] = columns[q, i]
            _forward(L, m, rows[q])
        for h in range(count):
            size = first[h + 1] - first[h]
            for i in range(size):
                one = rows[first[h] + i]
                value = 0.0
                for k in range(m):
                    value += one[k] * z_white[k]
                b[i] = value
                for j in range(i + 1):
                    other = rows[first[h] + j]
                    value = 1.0 if i == j else 0.0
                    for k in range(m):
                        value += one[k] * other[k]
                    M[i, j] = value
            log_determinant = _factor(M, size, M_factor)
            _forward(M_factor, size, b)
            value = 0.0
            for i in range(size):
                value += b[i] * b[i]
            gains[h, p] = log_weight[p] + 0.5 * (value - log_determinant)
    without = normalise(log_weight, weight)
    for h in range(count):
        log_factors[h] = normalise(gains[h], weight) - without
