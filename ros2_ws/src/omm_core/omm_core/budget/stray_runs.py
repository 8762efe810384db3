"""Runs of a campaign that stray from the others of their clamping by more than chance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

# Of a campaign without any such run, so many are told of one.
_LEVEL = 0.01


def stray_runs(clampings: Sequence[int], values: Array) -> list[tuple[int, int, float]]:
    """Return the runs that stray: index of run, of quantity, and of how many others' σ.

    The externally studentised residual about the clamping's mean, ``t = r / (s √(1 - 1/n))`` with
    s from all the other residuals, against Student's distribution at a level divided by the number
    of tests (Bonferroni). Of two repeats, both lie equally far from their mean: both are told.
    Where each clamping has one run only, all runs are one group.

    Parameters
    ----------
    clampings : (N,)
    values : (N, Q) array
    """
    labels = np.asarray(clampings)
    _, group, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    if sizes.max() == 1:
        group, sizes = np.zeros(len(labels), dtype=int), np.array([len(labels)])
    freedom = len(labels) - len(sizes) - 1
    if freedom < 2:
        return []
    limit = float(stats.t.isf(_LEVEL / (2.0 * values.size), freedom))
    free = 1.0 - 1.0 / sizes[group]
    found = []
    for index, column in enumerate(values.T):
        means = np.bincount(group, column - column[0]) / sizes
        residual = column - column[0] - means[group]
        own = residual**2 / np.where(free > 0.0, free, 1.0)
        others = np.clip((residual**2).sum() - own, 0.0, None) / freedom
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.sqrt(own / others)
        found += [(int(i), index, float(t[i])) for i in np.flatnonzero(t > limit)]
    return found
