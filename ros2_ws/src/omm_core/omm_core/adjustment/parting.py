"""Dense symmetric equations of which one group, whose rows do not know of each other, goes first.

Photographs meet each other only in the points and the lens. Their part of the matrix is a row of
small blocks D beside the rest R and what connects both, B: R - Bᵀ D⁻¹ B is all that must be
factorised (Schur's complement; Brown 1958). Of 200 photographs and 300 points that is an eighth of
the work.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

from omm_core.adjustment.problem import Problem

Array = NDArray[np.float64]

_WORTH = 120  # unknowns of a group, from which on it is worth while
_BLOCK = 256


def apart(problem: Problem) -> tuple[slice, int] | None:
    """Return the largest group whose rows have nothing in common: where it stands, and k."""
    best: tuple[slice, int] | None = None
    most = _WORTH - 1
    for group in problem.adjusted():
        tied = group.covariance is not None or group.name in problem.datum
        twice = any(
            sum(r.split(":", 1)[0] == group.name for r in block.index) > 1
            for block in problem.blocks
        )
        if tied or twice or group.held is not None or group.values.size <= most:
            continue
        most = group.values.size
        best = problem.slices()[group.name], group.values.shape[1]
    return best


class Parted:
    """Scaled normal equations whose unknowns ``own`` make blocks of k that nothing connects.

    Where they are not positive definite, `step` and `inverse` return None.

    Parameters
    ----------
    normal, free : (U, U), (U,) arrays
        Of all unknowns; what is not free does not take part. All of ``own`` is free.
    scale : (n,) array
        Of the free unknowns.
    datum : (n, c) array or None
        G, whose G Gᵀ is added; zero for ``own``.
    """

    def __init__(
        self,
        normal: Array,
        free: NDArray[np.bool_],
        scale: Array,
        datum: Array | None,
        parting: tuple[slice, int],
    ) -> None:
        own, self.k = parting
        start = int(free[: own.start].sum())
        self.own, self.size = slice(start, start + own.stop - own.start), len(scale)
        self.rest = np.r_[:start, self.own.stop : self.size]
        rest = np.flatnonzero(free)[self.rest]
        of_own, of_rest = scale[self.own], scale[self.rest]
        count = len(of_own) // self.k
        blocks = np.einsum("iaib->iab", normal[own, own].reshape(count, self.k, count, self.k))
        units = of_own.reshape(count, self.k)
        self.blocks = blocks * units[:, :, None] * units[:, None, :]
        self.across = normal[own][:, rest] * of_own[:, None] * of_rest
        self.others = normal[np.ix_(rest, rest)] * of_rest[:, None] * of_rest
        if datum is not None:
            self.others += datum[self.rest] @ datum[self.rest].T

    def step(self, right: Array, added: float) -> Array | None:
        """Return the solution for a right side, with more on the diagonal."""
        found = self._reduced(added)
        if found is None:
            return None
        low, half, reduced = found
        root, failed = dpotrf(reduced.T, lower=1, clean=0, overwrite_a=1)
        if failed:
            return None
        own = (low @ right[self.own].reshape(-1, self.k, 1)).ravel()
        step = np.empty(self.size)
        step[self.rest] = dpotrs(root, right[self.rest] - half.T @ own, lower=1)[0]
        left = (own - half @ step[self.rest]).reshape(-1, self.k, 1)
        step[self.own] = (np.swapaxes(low, 1, 2) @ left).ravel()
        return step

    def inverse(self) -> Array | None:
        """Return the whole inverse."""
        found = self._reduced(0.0)
        if found is None:
            return None
        low, half, reduced = found
        corner = inverted(reduced.T)
        if corner is None:
            return None
        up = np.swapaxes(low, 1, 2)
        solved = (up @ half.reshape(-1, self.k, len(self.rest))).reshape(half.shape)
        across = -solved @ corner
        whole = np.empty((self.size, self.size))
        own = -across @ solved.T
        rows = own.reshape(len(low), self.k, len(low), self.k)
        np.einsum("iaib->iab", rows)[...] += up @ low
        whole[self.own, self.own] = own
        before, stop = self.own.start, self.own.stop
        for here, there in ((slice(0, before), slice(0, before)),
                            (slice(stop, None), slice(before, None))):  # fmt: skip
            whole[self.own, here] = across[:, there]
            whole[here, self.own] = across[:, there].T
        whole[np.ix_(self.rest, self.rest)] = corner
        return _mirrored(whole)

    def _reduced(self, added: float) -> tuple[Array, Array, Array] | None:
        """Return inverse roots of the blocks, these times what connects, and what is left."""
        try:
            roots = np.linalg.cholesky(self.blocks + added * np.eye(self.k))
        except np.linalg.LinAlgError:
            return None
        low = np.linalg.inv(roots)
        across = self.across.reshape(len(low), self.k, -1)
        half = (low @ across).reshape(self.across.shape)
        reduced = self.others - half.T @ half
        np.einsum("ii->i", reduced)[...] += added
        return low, half, reduced


def inverted(matrix: Array) -> Array | None:
    """Return the inverse of a symmetric matrix, None where it is not positive definite.

    The matrix lies column by column, as LAPACK wants it, and is overwritten.
    """
    root, failed = dpotrf(matrix, lower=1, clean=0, overwrite_a=1)
    return None if failed else _mirrored(dpotri(root, lower=1, overwrite_c=1)[0]).T


def _mirrored(half: Array) -> Array:
    """Write what stands below a matrix's diagonal above it, too, block by block."""
    for start in range(0, len(half), _BLOCK):
        stop = start + _BLOCK
        own = np.tril(half[start:stop, start:stop])
        half[start:stop, start:stop] = own + np.tril(own, -1).T
        half[start:stop, stop:] = half[stop:, start:stop].T
    return half
