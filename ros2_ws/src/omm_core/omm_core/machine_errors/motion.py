"""Errors that follow from how a machine moved and how warm it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def approach_signs(path_mm: ArrayLike) -> Array:
    """Return from which side each axis last came to each place of a path.

    Parameters
    ----------
    path_mm : (S, 3) array
        Places in the order in which they are gone to; the first is where the machine stands.

    Returns
    -------
    (S, 3) array
        +1 where the axis last moved towards plus, -1 towards minus, 0 while it has not moved.
    """
    path = np.asarray(path_mm, dtype=float)
    signs = np.zeros_like(path)
    for k in range(1, len(path)):
        moved = np.sign(path[k] - path[k - 1])
        signs[k] = np.where(moved == 0.0, signs[k - 1], moved)
    return signs


def lost_motion(signs: ArrayLike, width_mm: ArrayLike) -> Array:
    """Return true minus commanded, (..., 3): each axis stays behind by half of its lost motion.

    ``width_mm`` (3,) is the difference between coming to a place from either side (the reversal
    value of ISO 230-2).
    """
    return -0.5 * np.asarray(signs, dtype=float) * np.asarray(width_mm, dtype=float)


def spindle_drift(time_s: ArrayLike, final_mm: ArrayLike, constant_s: float) -> Array:
    """Return how far warming up has moved the spindle, (..., 3).

    Parameters
    ----------
    time_s : (...) array
        Since the measurement began; before it nothing has moved.
    final_mm : (3,) array
        Where the drift ends, in the machine's axes.
    constant_s : float
        Time constant: after it, 63 % of the way.
    """
    share = -np.expm1(-np.maximum(np.asarray(time_s, dtype=float), 0.0) / constant_s)
    return share[..., None] * np.asarray(final_mm, dtype=float)


def thermally_expanded(xyz_mm: ArrayLike, kelvin: float, expansion_per_K: float) -> Array:
    """Return coordinates (..., 3) of a part that is warmer than when it was surveyed.

    It expands about its own origin.
    """
    return np.asarray(xyz_mm, dtype=float) * (1.0 + kelvin * expansion_per_K)
