"""Another datum: coordinates turned and shifted, the covariance carried over (S-transformation).

A free network's covariance is that of one datum among many. With H (3n, 6), the directions in which
all points can be moved together, and B (3n, 6), what the wanted datum holds still,
``S = I - H (Bᵀ H)⁻¹ Bᵀ`` takes it to that datum: ``C' = S C Sᵀ`` (Baarda 1973). Lengths and angles
and what is known of them do not change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.adjustment import rigid_directions
from omm_core.errors import MeasurementError

Array = NDArray[np.float64]

_STRAIGHT = 0.02  # height of a triangle by its length, from which on it fixes a frame


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """A frame: ``x_new = turn x + shift``; ``held`` (3n, 6) is what its datum holds still."""

    turn: Array
    shift: Array
    held: Array

    def moved(self, points: Array) -> Array:
        """Return points (n, 3) in the new frame."""
        return np.asarray(points @ self.turn.T + self.shift)

    def covariance(self, points: Array, covariance: Array) -> Array:
        """Return the covariance (3n, 3n) of `points`, moved, in the new datum."""
        n = len(points)
        turned = np.einsum("ij,ajbk->aibk", self.turn, covariance.reshape(n, 3, n, 3))
        turned = np.einsum("aibk,lk->aibl", turned, self.turn).reshape(3 * n, 3 * n)
        directions = rigid_directions(self.moved(points))
        # The same as S C Sᵀ with a thin matrix: S = I - D Bᵀ.
        d = directions @ np.linalg.inv(self.held.T @ directions)
        half = turned - d @ (self.held.T @ turned)
        return np.asarray(half - (half @ self.held) @ d.T)


def free_frame(points: Array) -> Frame:
    """Return the frame in which points are, with the inner constraints over all of them."""
    return Frame(turn=np.eye(3), shift=np.zeros(3), held=rigid_directions(points))


def frame_of_three(points: Array, rows: tuple[int, int, int]) -> Frame:
    """Return the frame of three points: origin, on the x axis, in the x-y plane with y > 0.

    Raises
    ------
    MeasurementError
        Where they lie on a line.
    """
    origin, on_x, in_plane = (points[row] for row in rows)
    x = (on_x - origin) / np.linalg.norm(on_x - origin)
    across = np.cross(x, in_plane - origin)
    if np.linalg.norm(across) < _STRAIGHT * np.linalg.norm(on_x - origin):
        raise MeasurementError(
            "Expected three targets that span a plane for the datum; these lie on a line. Choose"
            " others."
        )
    z = across / np.linalg.norm(across)
    turn = np.array([x, np.cross(z, x), z])
    held = np.zeros((3 * len(points), 6))
    still = [(rows[0], 0), (rows[0], 1), (rows[0], 2), (rows[1], 1), (rows[1], 2), (rows[2], 2)]
    for column, (row, axis) in enumerate(still):
        held[3 * row + axis, column] = 1.0
    return Frame(turn=turn, shift=-turn @ origin, held=held)


def frame_of_nominal(points: Array, rows: list[int], nominal: Array) -> tuple[Frame, Array]:
    """Return the frame that fits points best to nominal coordinates (m, 3), and what is left.

    Raises
    ------
    MeasurementError
        Where there are fewer than three, or they lie on a line.
    """
    chosen = points[rows]
    centred, wanted = chosen - chosen.mean(axis=0), nominal - nominal.mean(axis=0)
    spread = np.linalg.svd(centred, compute_uv=False)
    if len(rows) < 3 or spread[1] < _STRAIGHT * spread[0]:
        raise MeasurementError(
            "Expected three nominal targets or more, not on a line, among the measured ones; got"
            f" {len(rows)}."
        )
    turn = Rotation.align_vectors(wanted, centred)[0].as_matrix()
    shift = nominal.mean(axis=0) - turn @ chosen.mean(axis=0)
    used = np.zeros(len(points), dtype=bool)
    used[rows] = True
    held = rigid_directions(points @ turn.T + shift, used)
    frame = Frame(turn=turn, shift=shift, held=held)
    return frame, frame.moved(chosen) - nominal
