"""Directions in which a free network can be moved, as inner constraints."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def similarity_directions(points: ArrayLike, used: ArrayLike | None = None) -> Array:
    """Return shift (3), turn (3) and scale (1) of points as directions, (3 n, 7).

    Parameters
    ----------
    points : (n, 3) array
    used : (n,) bool array, optional
        Points over which the datum is taken; the others' rows are zero.
    """
    p = np.asarray(points, dtype=float)
    chosen = np.ones(len(p), dtype=bool) if used is None else np.asarray(used, dtype=bool)
    centred = p - p[chosen].mean(axis=0)
    directions = np.zeros((len(p), 3, 7))
    directions[:, :, :3] = np.eye(3)
    directions[:, :, 3:6] = np.swapaxes(np.cross(np.eye(3)[None], centred[:, None, :]), 1, 2)
    directions[:, :, 6] = centred
    directions[~chosen] = 0.0
    return directions.reshape(-1, 7)


def rigid_directions(points: ArrayLike, used: ArrayLike | None = None) -> Array:
    """Return shift (3) and turn (3) of points as directions, (3 n, 6)."""
    return similarity_directions(points, used)[:, :6]
