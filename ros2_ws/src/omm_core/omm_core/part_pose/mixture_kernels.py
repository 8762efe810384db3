"""The pose over the grid of noise components: a mixture of normals, its moments and half widths."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from omm_core.imaging.kernels import FASTMATH

_compiled = njit(cache=True, error_model="numpy", fastmath=FASTMATH)
_NEGLIGIBLE = 1e-8  # of the largest weight
_WITHOUT_WIDTH = 3e-5  # the same, for the half widths


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
