"""What becomes of a plan where the part lies elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform, rotation_from_euler_xyz_rad
from omm_core.planning.collision import clearance_mm
from omm_core.planning.prediction import designs, own_covariances
from omm_core.planning.scene import Scene
from omm_core.planning.views import views
from omm_core.planning.wish import Yardstick

Array = NDArray[np.float64]

SHIFT_MM = 50.0
TURN_RAD = np.deg2rad(1.0)


@dataclass(frozen=True, kw_only=True)
class Elsewhere:
    """One way in which the part lies elsewhere, and what the same stops then give.

    Attributes
    ----------
    words : str
        Such as ``x +50 mm`` or ``turned about z -1°``; turns are about the targets' middle.
    seen, planned : int
        Views of targets: that are left, that were planned.
    worst_corner_U_mm : float
        Infinite where the pose is not determined any more.
    clearance_mm : float
        Smallest distance of the camera's body from the part's box at the stops; 0 where they meet.
    """

    words: str
    seen: int
    planned: int
    worst_corner_U_mm: float
    clearance_mm: float

    def to_json(self) -> dict[str, Any]:
        """Return plain numbers; None where the pose is not determined."""
        U = self.worst_corner_U_mm
        return {
            "part": self.words, "views_left": self.seen, "views_planned": self.planned,
            "worst_corner_U_mm": U if np.isfinite(U) else None,
            "clearance_mm": self.clearance_mm,
        }  # fmt: skip


def lies_elsewhere(
    scene: Scene, yardstick: Yardstick, spindles: Sequence[RigidTransform]
) -> tuple[Elsewhere, ...]:
    """Return what the stops give where the part is shifted or turned, each way alone."""
    planned = int(views(scene.elsewhere(scene.machine_T_part), spindles).visible.sum())
    results = []
    for words, moved in _places(scene):
        there = scene.elsewhere(moved)
        seen = views(there, spindles)
        results.append(
            Elsewhere(
                words=words,
                seen=int(seen.visible.sum()),
                planned=planned,
                worst_corner_U_mm=_worst_U(there, yardstick, spindles, seen),
                clearance_mm=float(clearance_mm(there, list(spindles)).min()),
            )
        )
    return tuple(results)


def _places(scene: Scene) -> list[tuple[str, RigidTransform]]:
    middle = scene.targets_in_machine().mean(axis=0)
    places = []
    for axis, name in enumerate("xyz"):
        for sign in (1.0, -1.0):
            shift = np.zeros(3)
            shift[axis] = sign * SHIFT_MM
            moved = RigidTransform(rotation=np.eye(3), translation_mm=shift)
            places.append((f"{name} {sign * SHIFT_MM:+.0f} mm", moved))
    for axis, name in enumerate("xyz"):
        for sign in (1.0, -1.0):
            angles = np.zeros(3)
            angles[axis] = sign * TURN_RAD
            R = rotation_from_euler_xyz_rad(*angles)
            turned = RigidTransform(rotation=R, translation_mm=middle - R @ middle)
            places.append((f"turned about {name} {np.rad2deg(sign * TURN_RAD):+.0f}°", turned))
    return [(words, moved @ scene.machine_T_part) for words, moved in places]


def _worst_U(scene, yardstick, spindles, seen) -> float:  # type: ignore[no-untyped-def]
    if not np.any(seen.visible):
        return float("inf")
    every = np.arange(len(spindles))[None]
    covariance = own_covariances(designs(scene, spindles, seen), scene.noise, every)[0]
    U = float(yardstick.corner_U_mm(covariance).max())
    return U if U < 1e3 else float("inf")
