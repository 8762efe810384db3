"""What is asked of the overstock, point by point and group by group."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Balance:
    """The mean overstock of one group minus another's must lie between two limits, mm."""

    first: int
    second: int
    low_mm: float
    high_mm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Wish:
    """What each point's overstock is held against.

    Attributes
    ----------
    groups : (N,) array of int
        Group of each point.
    required_mm : (N,) array
        Allowance: the margin is the overstock less this; -inf where nothing is milled.
    maximum_mm : (N,) array or None
        The overstock must not exceed this; inf where there is no limit.
    datum_mm : (N,) array or None
        The overstock is to be this, and gives no margin; nan for points that are no datum.
    datum_rank : (N,) array of int or None
        Of datum points: the lowest rank is fitted first, the next in what freedom is left.
    balances : tuple of Balance
        Tolerances between groups.
    """

    groups: NDArray[np.int64]
    required_mm: Array
    maximum_mm: Array | None = None
    datum_mm: Array | None = None
    datum_rank: NDArray[np.int64] | None = None
    balances: tuple[Balance, ...] = ()

    @property
    def is_datum(self) -> NDArray[np.bool_]:
        """Return which points are datum."""
        if self.datum_mm is None:
            return np.zeros(len(self.groups), dtype=bool)
        return ~np.isnan(self.datum_mm)

    @property
    def is_aside(self) -> NDArray[np.bool_]:
        """Return which points give no margin: datum, and faces that are not milled."""
        return self.is_datum | np.isneginf(self.required_mm)

    def limits(self, overstock: Array, jacobian: Array) -> tuple[Array, Array]:
        """Return what must stay >= 0 (L,), and its derivatives (L, 6)."""
        values, rows = [np.empty(0)], [np.empty((0, jacobian.shape[1]))]
        if self.maximum_mm is not None:
            bound = np.isfinite(self.maximum_mm)
            values.append(self.maximum_mm[bound] - overstock[bound])
            rows.append(-jacobian[bound])
        for balance in self.balances:
            a, b = self.groups == balance.first, self.groups == balance.second
            if a.any() and b.any():
                apart = overstock[a].mean() - overstock[b].mean()
                slope = jacobian[a].mean(axis=0) - jacobian[b].mean(axis=0)
                values.append(np.array([apart - balance.low_mm, balance.high_mm - apart]))
                rows.append(np.array([slope, -slope]))
        return np.concatenate(values), np.vstack(rows)
