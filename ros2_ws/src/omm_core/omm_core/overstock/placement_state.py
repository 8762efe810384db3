"""Overstock and its derivatives at a placement, and what a placement is told as."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.overstock.wish import Wish

Array = NDArray[np.float64]


Pose = tuple[Array, Array]
# Points in the part frame (N, 3) -> distance outside each point's own face (N,), normals (N, 3).
Surfaces = Callable[[Array], tuple[Array, Array]]
RANK = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Placement:
    """A placement of the survey's points in the part frame.

    Attributes
    ----------
    rotation : (3, 3) array
        part_R_survey.
    translation_mm : (3,) array
        part_T_survey's translation.
    overstock_mm, margins_mm : (N,) arrays
        Per point; the margin of a datum point is inf, for it is not to be raised.
    jacobian : (N, 6) array
        Of the overstock in (translation, rotation times size) about the centroid, part frame.
    centre_mm : (3,) array
        The centroid.
    size_mm : float
        What the rotation was multiplied by.
    limiting : (N,) array
        Multipliers of the smallest margin (sum 1); zero where a point does not limit.
    limits_held : (L,) array
        Multipliers of the limits, in the order of ``Wish.limits``.
    breach_mm : float
        By how much a limit is broken, 0 where all hold.
    free : (K, 6) array
        Motions that no point holds.
    loose : (M, 6) array
        Motions that only add material where there are points: nothing stops the part.
    """

    rotation: Array
    translation_mm: Array
    overstock_mm: Array
    margins_mm: Array
    jacobian: Array
    centre_mm: Array
    size_mm: float
    limiting: Array
    limits_held: Array
    breach_mm: float
    free: Array
    loose: Array

    @property
    def smallest_mm(self) -> float:
        """Return the smallest margin."""
        return float(self.margins_mm.min())

    @property
    def pose(self) -> Pose:
        """Return rotation and translation."""
        return self.rotation, self.translation_mm


class PlacementState:
    """Overstock and its derivatives at a placement."""

    def __init__(
        self, points: Array, surfaces: Surfaces, thickness_mm: float, wish: Wish, pose: Pose
    ) -> None:
        self.pose = pose
        placed = points @ pose[0].T + pose[1]
        distance, normals = surfaces(placed)
        self.overstock = distance - thickness_mm
        self.centre = placed.mean(axis=0)
        arms = placed - self.centre
        self.size = max(float(np.sqrt((arms**2).sum(axis=1).mean())), 1e-9)
        self.jacobian = np.hstack([normals, np.cross(arms, normals) / self.size])
        self.margins = np.where(wish.is_aside, np.inf, self.overstock - wish.required_mm)
        self.limits, self.limit_rows = wish.limits(self.overstock, self.jacobian)
        self.correction, self.freedom = _datum(self.overstock, self.jacobian, wish)

    def moved(self, step: Array) -> Pose:
        """Return the pose after a small motion."""
        turn = Rotation.from_rotvec(step[3:] / self.size).as_matrix()
        rotation, translation = self.pose
        return turn @ rotation, turn @ (translation - self.centre) + self.centre + step[:3]

    def breach(self, floor: Array) -> float:
        """Return by how much the worst limit or floor is broken."""
        held = ~np.isnan(floor)
        values = np.concatenate([self.limits, (self.margins - floor)[held], [0.0]])
        return float(max(-values.min(), 0.0) + np.abs(self.correction).max())


def _datum(overstock: Array, jacobian: Array, wish: Wish) -> tuple[Array, Array]:
    """Return the motion that brings the datum faces to their stock, and what freedom is left."""
    step, freedom = np.zeros(6), np.eye(6)
    if wish.datum_mm is None or wish.datum_rank is None:
        return step, freedom
    for rank in np.unique(wish.datum_rank[wish.is_datum]):
        on = wish.is_datum & (wish.datum_rank == rank)
        if freedom.shape[1] == 0:
            break
        rows = jacobian[on] @ freedom
        wanted = wish.datum_mm[on] - overstock[on] - jacobian[on] @ step
        values, axes = np.linalg.eigh(rows.T @ rows)
        known = values > RANK**2 * max(1.0, values[-1])
        answer = axes[:, known] @ ((axes[:, known].T @ (rows.T @ wanted)) / values[known])
        step = step + freedom @ answer
        freedom = freedom @ axes[:, ~known]
    return step, freedom
