"""What is adjusted: groups of unknowns, blocks of observations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError

Array = NDArray[np.float64]
Values = Mapping[str, Array]
Evaluate = Callable[[Values], tuple[Array, Mapping[str, Array]]]
Update = Callable[[Array, Array], Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Group:
    """Unknowns of one kind: n rows of k values each.

    Attributes
    ----------
    name : str
    values : (n, k) array
        Where the adjustment starts.
    fixed : bool
        Whether none of them is adjusted.
    held : (n, k) bool array or None
        Which single values are kept as they are.
    sigma : (n, k) array or None
        Standard deviations of what was observed; ``inf`` where a value was not.
    covariance : (n k, n k) array or None
        Instead of ``sigma``: the full covariance, row after row.
    observed : (n, k) array or None
        What was observed; ``values`` where not given.
    update : callable or None
        ``(values, step) -> values`` where values do not add up.
    names : tuple of str
        Of the k columns, for what people read.
    """

    name: str
    values: Array
    fixed: bool = False
    held: NDArray[np.bool_] | None = None
    sigma: Array | None = None
    covariance: Array | None = None
    observed: Array | None = None
    update: Update | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if np.ndim(self.values) != 2:
            raise InputError(f"Expected '{self.name}' as (n, k), got {np.shape(self.values)}.")
        if self.sigma is not None and self.covariance is not None:
            raise InputError(f"Expected sigma or covariance for '{self.name}', got both.")
        for what in (self.held, self.sigma, self.observed):
            if what is not None and np.shape(what) != np.shape(self.values):
                raise InputError(
                    f"Expected '{self.name}' in the shape {np.shape(self.values)} throughout, "
                    f"got {np.shape(what)}."
                )

    def weight(self) -> Array | None:
        """Return the inverse covariance (n k, n k) or its diagonal (n k,); None if free."""
        if self.covariance is not None:
            return np.asarray(np.linalg.inv(self.covariance), dtype=float)
        return None if self.sigma is None else np.asarray(self.sigma.ravel() ** -2.0)

    def target(self) -> Array:
        """Return what was observed, (n k,)."""
        return (self.values if self.observed is None else self.observed).ravel()

    def label(self, position: int) -> str:
        """Return the name of the value at a position of the flattened group."""
        row, column = divmod(position, self.values.shape[1])
        what = self.names[column] if self.names else f"[{column}]"
        return what if len(self.values) == 1 else f"{self.name} {row} {what}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """Observations of one kind: m of d values each.

    Attributes
    ----------
    name : str
    observed : (m, d) array
    covariance : (m, d, d) array
    index : mapping
        By reference (``group`` or ``group:anything``): which row of the group each sees, (m,).
    evaluate : callable
        Values of the groups -> predicted (m, d), derivatives (m, d, k) by reference.
    used : (m,) bool array or None
        Which take part; all where not given.
    """

    name: str
    observed: Array
    covariance: Array
    index: Mapping[str, NDArray[np.integer]]
    evaluate: Evaluate
    used: NDArray[np.bool_] | None = None

    def weights(self) -> Array:
        """Return the inverse covariances (m, d, d); zero for what does not take part."""
        weights = np.linalg.inv(self.covariance)
        return np.asarray(
            weights if self.used is None else weights * self.used[:, None, None], dtype=float
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """Groups, blocks, and the datum: inner constraints (n k, c) by group."""

    groups: tuple[Group, ...]
    blocks: tuple[Block, ...]
    datum: Mapping[str, Array] = field(default_factory=dict)

    def adjusted(self) -> tuple[Group, ...]:
        """Return the groups that are adjusted, in the order of the covariance."""
        return tuple(group for group in self.groups if not group.fixed)

    def slices(self) -> dict[str, slice]:
        """Return where each adjusted group stands among all unknowns."""
        found: dict[str, slice] = {}
        start = 0
        for group in self.adjusted():
            found[group.name] = slice(start, start + group.values.size)
            start += group.values.size
        return found

    def free(self) -> NDArray[np.bool_]:
        """Return which of the unknowns are not held, (U,)."""
        return np.concatenate(
            [
                np.ones(group.values.size, dtype=bool)
                if group.held is None
                else ~group.held.ravel()
                for group in self.adjusted()
            ]
        )

    def datum_matrix(self) -> Array:
        """Return G, (U, c)."""
        slices = self.slices()
        size = sum(group.values.size for group in self.adjusted())
        columns = max((np.shape(g)[1] for g in self.datum.values()), default=0)
        matrix = np.zeros((size, columns))
        for name, directions in self.datum.items():
            matrix[slices[name], : np.shape(directions)[1]] = directions
        return matrix

    def labels(self) -> list[str]:
        """Return a name for each unknown, (U,)."""
        return [group.label(i) for group in self.adjusted() for i in range(group.values.size)]
