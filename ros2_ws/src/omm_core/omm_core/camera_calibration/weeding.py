"""Leave out what does not fit: robust weights for the start, then w-tests, one round after another.

A round leaves out all observations whose test is beyond the limit and within a factor of four of
the worst one: what a blunder does to its neighbours is smaller. What was left out and fits after
all is taken back. An image of which more than half is left out goes as a whole: it is not of the
set, or the spindle was elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Problem, Solution, test_observations
from omm_core.adjustment.statistics import predicted_covariance
from omm_core.errors import MeasurementError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]

# w-test (chi-square, 2 degrees of freedom): one in a million of good observations is refused.
LARGEST_T2 = 27.6
_MEDIAN = 1.386  # of that chi-square
_MOST = 0.2  # of all observations that may be wrong
_BESIDE = 0.25
_LEAST_PX = 0.3
_ROUNDS = 40


@dataclass(frozen=True, kw_only=True, eq=False)
class Weeded:
    """What is left: the last problem and its solution, which are used, and why others are not."""

    problem: Problem
    solution: Solution
    used: Mask
    reasons: tuple[str | None, ...]
    whole_images: tuple[int, ...]


def robust_inflation(residuals_px: Array) -> Array:
    """Return what to multiply covariances with, (N,), so that blunders bend nothing (Cauchy)."""
    size = np.linalg.norm(residuals_px, axis=1)
    scale = max(1.4826 * float(np.median(size)), _LEAST_PX)
    return np.asarray(1.0 + (size / (2.0 * scale)) ** 2)


def weed(
    adjust: Callable[[Mask], tuple[Problem, Solution]],
    image_of: Indices,
    used: Mask,
    *,
    least: int,
    refuse_moved: Callable[[Problem, Solution], None],
) -> Weeded:
    """Adjust until everything that is used fits.

    Parameters
    ----------
    adjust : callable
        Which observations of the block "pixels" are used (N,) -> problem and its solution.
    image_of : (N,) array
        The image of each observation.
    used : (N,) bool array
        To begin with.
    least : int
        Observations below which none is left out.
    refuse_moved : callable
        Raises where something moved while the set was taken: asked of what fits in the end, and
        of everything where too much does not.

    Raises
    ------
    MeasurementError
        Where more than a fifth does not fit.
    """
    used = used.copy()
    back = False
    for _ in range(_ROUNDS):
        problem, solution = adjust(used)
        t2 = test_observations(problem, solution)["pixels"].t2
        scale = max(float(np.median(t2[used])) / _MEDIAN, 1.0)
        wrong = used & (t2 > LARGEST_T2 * scale)
        if wrong.any() and used.sum() > least:
            used = used & ~(wrong & (t2 >= _BESIDE * float(t2[wrong].max())))
            if used.sum() < (1 - _MOST) * len(used):
                refuse_moved(*adjust(np.ones(len(used), dtype=bool)))
                raise _too_many(used)
            continue
        again = ~used & _fits(problem, solution, scale)
        if back or not again.any():
            break
        used, back = used | again, True
    whole = _whole_images(used, image_of)
    if (used & np.isin(image_of, whole)).any():
        used = used & ~np.isin(image_of, whole)
        problem, solution = adjust(used)
    refuse_moved(problem, solution)
    return Weeded(
        problem=problem,
        solution=solution,
        used=used,
        reasons=tuple(_reason(u, int(i) in whole) for u, i in zip(used, image_of, strict=True)),
        whole_images=whole,
    )


def _whole_images(used: Mask, image_of: Indices) -> tuple[int, ...]:
    seen = np.bincount(image_of)
    out = np.bincount(image_of[~used], minlength=len(seen))
    return tuple(int(i) for i in np.flatnonzero((out > seen / 2) & (seen > 1)))


def _fits(problem: Problem, solution: Solution, scale: float) -> Mask:
    """Return which residuals, predicted from what is used, are within the limit, (N,)."""
    block = next(b for b in problem.blocks if b.name == "pixels")
    spread = block.covariance + predicted_covariance(
        block, solution.derivatives["pixels"], solution
    )
    residual = solution.residuals["pixels"]
    finite = np.isfinite(residual).all(axis=1) & (np.abs(residual) > 0).any(axis=1)
    solved = np.linalg.solve(spread, residual[..., None])[..., 0]
    return np.asarray(finite & (np.einsum("mi,mi->m", residual, solved) < LARGEST_T2 * scale))


def _too_many(used: Mask) -> MeasurementError:
    return MeasurementError(
        f"More than a fifth of the observations ({(~used).sum()} of {len(used)}) do not fit the"
        " others: images and places are mixed up, the places are in other axes (taper frame),"
        " or something moved while the set was taken."
    )


def _reason(used: bool, in_whole: bool) -> str | None:
    if used:
        return None
    return (
        "the image is not of the set (w-test)" if in_whole else "does not fit the others (w-test)"
    )
