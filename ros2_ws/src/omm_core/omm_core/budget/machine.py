"""What the machine itself adds where it goes to a point of the part: u_machine.

The part's pose is in the machine's own coordinates: what the machine's geometry does at the stops
is in it already, as far as a rigid fit over the targets goes. What is left at a point is the
geometry's error there minus that fit, and one more stop. The geometry is a field of covariance
``σ² exp(−d² / 2 l²)`` between commanded spindle places d apart, each axis by itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def geometry_left_mm(
    sigma_mm: float,
    length_mm: float,
    stops_mm: Array,
    seen: Sequence[tuple[Array, Sequence[int]]],
    points_mm: Array,
    tool_mm: Array,
) -> Array:
    """Return the standard deviation of what the geometry's error is beyond the rigid fit, (P, 3).

    Parameters
    ----------
    stops_mm : (S, 3) array
        Commanded spindle places of the images.
    seen : sequence of (target's place in the machine (3,), indices of the stops that saw it)
    points_mm : (P, 3) array
        Where the tool goes to, machine frame.
    tool_mm : (3,) array
        From the spindle to the tool's tip, machine axes.
    """
    places = np.array([place for place, _ in seen])
    centre = places.mean(axis=0)
    mean = np.zeros((len(seen), len(stops_mm)))
    for row, (_, stops) in enumerate(seen):
        mean[row, list(stops)] = 1.0 / len(stops)
    fit = np.linalg.pinv(np.vstack([_rigid(place - centre) for place in places]))
    # The fit's motion in terms of the error at each stop, (6, 3 S).
    motion = fit @ np.kron(mean, np.eye(3))
    spindle = np.asarray(points_mm) - np.asarray(tool_mm)
    found = np.empty((len(points_mm), 3))
    for index, (point, place) in enumerate(zip(points_mm, spindle)):
        weights = np.hstack([np.eye(3), -_rigid(point - centre) @ motion])
        kernel = _kernel(np.vstack([place, stops_mm]), length_mm)
        covariance = weights @ np.kron(kernel, np.eye(3)) @ weights.T
        found[index] = sigma_mm * np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    return found


def _rigid(offset: Array) -> Array:
    """Return how a small motion (rotation, shift) moves a point, (3, 6)."""
    x, y, z = offset
    turn = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    return np.hstack([turn, np.eye(3)])


def _kernel(places: Array, length_mm: float) -> Array:
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    return np.asarray(np.exp(-(distance**2) / (2.0 * length_mm**2)))
