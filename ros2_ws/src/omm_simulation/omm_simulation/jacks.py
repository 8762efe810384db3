"""A rigid part on three jacks that are turned: it moves by a rigid turn, not linearly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.geometry import RigidTransform

Array = NDArray[np.float64]


def lifted(
    machine_T_part: RigidTransform, feet_xy_mm: Sequence[Sequence[float]], lifts_mm: Sequence[float]
) -> RigidTransform:
    """Return the part's pose after three jacks were turned; they lift along machine Z.

    Parameters
    ----------
    feet_xy_mm : (3, 2)
        Where the jacks stand, from the part's origin, machine axes. They carry the plane through
        the origin that is level in the part's own frame.
    lifts_mm : (3,)
        Positive lifts.

    Raises
    ------
    InputError
        Where there are not three jacks.
    """
    if len(feet_xy_mm) != 3 or len(lifts_mm) != 3:
        raise InputError(f"Expected three jacks, got {len(feet_xy_mm)}.")
    origin, normal = machine_T_part.translation_mm, machine_T_part.rotation[:, 2]
    before = np.array([_on_plane(normal, origin, np.asarray(foot)) for foot in feet_xy_mm])
    after = before + np.outer(lifts_mm, [0.0, 0.0, 1.0])
    turn = _frame(after) @ _frame(before).T
    return RigidTransform(
        rotation=turn @ machine_T_part.rotation,
        translation_mm=after[0] + turn @ (origin - before[0]),
    )


def lifted_by_command(
    machine_T_part: RigidTransform, jacks: Sequence[Mapping[str, float]]
) -> RigidTransform:
    """Return the pose after jacks were turned by what the page says: ``x_mm y_mm mm`` each.

    The places are in the part's frame, as the page and the part file have them. A rigid part stands
    on three: of more, the first three count.
    """
    jacks = jacks[:3]
    feet = [machine_T_part.rotation @ [j["x_mm"], j["y_mm"], 0.0] for j in jacks]
    places = [(float(x), float(y)) for x, y, _ in feet]
    return lifted(machine_T_part, places, [j["mm"] for j in jacks])


def _on_plane(normal: Array, origin: Array, foot: Array) -> Array:
    z = origin[2] - (normal[:2] @ foot) / normal[2]
    return np.array([*(origin[:2] + foot), z])


def _frame(points: Array) -> Array:
    """Return axes that go with three points, as columns."""
    x = points[1] - points[0]
    z = np.cross(x, points[2] - points[0])
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])
