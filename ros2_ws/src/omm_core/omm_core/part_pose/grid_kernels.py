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

Array = NDArray[np.float64]

_compiled = njit(cache=True, error_model="numpy", fastmath=FASTMATH)
_NEGLIGIBLE = 1e-8  # of the largest weight
_NO_RANK = 1e-9  # of a column of length 1: what is left of it without those before
_WITHOUT_WIDTH = 3e-5  # the same, for the half widths


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
def normalise(log_weight, weight):
    """Fill the weights (P,), which sum to 1; return the logarithm of what they summed to."""
    largest = -np.inf
    for p in range(log_weight.size):
        largest = max(largest, log_weight[p])
    total = 0.0
    for p in range(log_weight.size):
        weight[p] = math.exp(log_weight[p] - largest)
        total += weight[p]
    for p in range(log_weight.size):
        weight[p] /= total
    return largest + math.log(total)


@_compiled
def moments(weight, deltas, covariances, to_theta, mean, covariance, means, sigmas):
    """Fill mean (7,) and covariance (7, 7) of the mixture of one statement, in θ.

    ``means``, ``sigmas`` (P, 7): those of each machine, 0 weight where negligible.
    """
    count, u = deltas.shape
    largest = 0.0
    for p in range(count):
        largest = max(largest, weight[p])
    room = np.empty((7, u))
    turned = np.ascontiguousarray(to_theta.T)
    mean[:] = 0.0
    covariance[:, :] = 0.0
    for p in range(count):
        if weight[p] < _NEGLIGIBLE * largest:
            continue
        for i in range(7):
            value = 0.0
            for k in range(u):
                value += to_theta[i, k] * deltas[p, k]
            means[p, i] = value
            mean[i] += weight[p] * value
            for k in range(u):
                room[i, k] = 0.0
            for j in range(u):
                factor = to_theta[i, j]
                for k in range(u):
                    room[i, k] += factor * covariances[p, j, k]
        for i in range(7):
            variance = 0.0
            for k in range(u):
                variance += room[i, k] * to_theta[i, k]
                factor = weight[p] * room[i, k]
                for j in range(i + 1):
                    covariance[i, j] += factor * turned[k, j]
            sigmas[p, i] = math.sqrt(max(variance, 0.0))
    for p in range(count):
        if weight[p] < _NEGLIGIBLE * largest:
            continue
        for i in range(7):
            for j in range(i + 1):
                covariance[i, j] += (
                    weight[p] * (means[p, i] - mean[i]) * (means[p, j] - mean[j])
                )  # fmt: skip
    for i in range(7):
        for j in range(i):
            covariance[j, i] = covariance[i, j]


@_compiled
def half_widths(weight, means, sigmas, mean, covariance, level, widths):
    """Fill the half widths (7,) about the mean that hold ``level`` of each marginal mixture.

    Newton's method on the share, inside an interval that is halved where it leaves it.
    """
    largest = 0.0
    for p in range(weight.size):
        largest = max(largest, weight[p])
    chosen = np.empty(weight.size, dtype=np.int64)
    count = 0
    for p in range(weight.size):
        if weight[p] > _WITHOUT_WIDTH * largest:
            chosen[count] = p
            count += 1
    for i in range(7):
        sigma = math.sqrt(max(covariance[i, i], 0.0))
        widths[i] = 0.0
        if not sigma > 0.0:
            continue
        low, high, width = 0.0, 40.0 * sigma, 2.0 * sigma
        for _ in range(100):
            share = slope = 0.0
            for k in range(count):
                p = chosen[k]
                s = sigmas[p, i]
                off = means[p, i] - mean[i]
                x, y = (width - off) / s, (width + off) / s
                share += weight[p] * (
                    1.0 - 0.5 * math.erfc(x * 0.7071067811865476)
                    - 0.5 * math.erfc(y * 0.7071067811865476)
                )  # fmt: skip
                slope += (
                    weight[p] * 0.3989422804014327
                    * (math.exp(-0.5 * x * x) + math.exp(-0.5 * y * y)) / s
                )  # fmt: skip
            error = share - level
            if error > 0.0:
                high = width
            else:
                low = width
            step = error / slope if slope > 0.0 else np.inf
            new = width - step
            if not (low < new < high):
                new = 0.5 * (low + high)
            if abs(new - width) < 1e-4 * sigma:  # what is left is the square of it
                width = new
                break
            width = new
        widths[i] = width


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
