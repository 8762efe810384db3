"""Did something move while the set was taken? A test at each place where it may have.

From one image on, the plate (or the camera, on a CMM) may have stood elsewhere: six more unknowns,
whose effect on the pixels is B for all images from there on. The score test needs no new
adjustment: with v the residuals, W their weights, A and Q of the adjustment::

    s = Bᵀ W v,   M = Bᵀ W B - Bᵀ W A Q Aᵀ W B,   the cost falls by sᵀ M⁻¹ s,   the step is M⁻¹ s

and what it falls by is compared with what is left (F-test), since something that moved is also
what makes all residuals large.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Block, Solution
from omm_core.adjustment.normal_equations import group_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_DOUBT = 1e-6
_LEAST_OBSERVATIONS = 4  # on either side


@dataclass(frozen=True, kw_only=True, eq=False)
class Moved:
    """From image ``first`` on (in the order taken) it stood elsewhere, by ``step`` (6,)."""

    first: int
    step: Array
    p_value: float


def moved_while_taken(
    block: Block, solution: Solution, by_pose: Array, image_of: Indices
) -> Moved | None:
    """Return where and by how much something moved, or None.

    Parameters
    ----------
    block : Block
        The pixels (m, 2).
    by_pose : (m, 2, 6) array
        Derivative of the pixels by the pose of what may have moved.
    image_of : (m,) array
        In the order taken.
    """
    from scipy.stats import f as f_distribution

    weights = block.weights()
    count = int(image_of.max()) + 1
    weighted_residual = np.einsum("mij,mj->mi", weights, solution.residuals["pixels"])
    weighted = weights @ by_pose
    score = np.einsum("mip,mi->mp", by_pose, weighted_residual)
    own = np.swapaxes(by_pose, 1, 2) @ weighted
    across = _across(block, solution, weighted)
    taking_part = np.ones(len(image_of), dtype=bool) if block.used is None else block.used
    later = _from_image_on(image_of, count)
    after, scores = later(taking_part.astype(float)), later(score)
    owns, mixes = later(own), later(across)
    best: Moved | None = None
    lowest = np.inf
    for first in range(1, count):
        if min(after[first], after[0] - after[first]) < _LEAST_OBSERVATIONS:
            continue
        s, mixed = scores[first], mixes[first]
        M = owns[first] - mixed @ solution.covariance @ mixed.T
        scale = 1.0 / np.sqrt(np.maximum(np.diag(owns[first]), 1e-300))
        step = scale * (
            np.linalg.pinv(M * np.outer(scale, scale), rcond=1e-9, hermitian=True) @ (scale * s)
        )
        fallen = float(s @ step)
        freedom = solution.degrees_of_freedom - len(s)
        left = solution.cost - fallen
        if freedom < 1 or not left > 0.0:
            continue
        ratio = fallen / len(s) / max(left / freedom, 1e-300)
        p_value = float(f_distribution.sf(ratio, len(s), freedom)) * count
        if left < lowest:
            best, lowest = Moved(first=first, step=step, p_value=p_value), left
    return best if best is not None and best.p_value < _DOUBT else None


def _from_image_on(image_of: Indices, count: int) -> Callable[[Array], Array]:
    """Return what sums values of observations (m, …) over each image and all after it."""

    def summed(values: Array) -> Array:
        by_image = np.zeros((count, *values.shape[1:]))
        np.add.at(by_image, image_of, values)
        return np.asarray(np.cumsum(by_image[::-1], axis=0)[::-1])

    return summed


def _across(block: Block, solution: Solution, weighted: Array) -> Array:
    """Return (W B)ᵀ A of each observation, (m, 6, U)."""
    m = len(weighted)
    across = np.zeros((m, weighted.shape[2], len(solution.covariance)))
    for reference, derivative in solution.derivatives["pixels"].items():
        k = derivative.shape[2]
        start = solution.slices[group_of(reference)].start
        columns = start + block.index[reference][:, None] * k + np.arange(k)
        product = np.swapaxes(weighted, 1, 2) @ derivative
        np.add.at(
            across,
            (np.arange(m)[:, None, None], np.arange(6)[None, :, None], columns[:, None]),
            product,
        )
    return across
