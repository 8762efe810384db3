"""What is true of a part in the coordinates of the machine that measures it.

A machine whose geometry errs carries its spindle to ``commanded + e``. To meet a target that lies
at P it goes, by its own scales, to ``P - e``. The **own** pose of a part is therefore the absolute
one minus the rigid motion that fits the geometry's errors at the targets best: unweighted, each
target counting once, with the mean of the errors at the stops that saw it. γ_s is a turn of the
holder in the spindle and stays what it is. What the errors do beyond a rigid motion is no pose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omm_core.errors import InputError
from omm_core.geometry import RigidTransform

Array = NDArray[np.float64]


def own_pose(
    machine_T_part: RigidTransform,
    targets_mm: ArrayLike,
    target_of: ArrayLike,
    geometry_mm: ArrayLike,
) -> RigidTransform:
    """Return the part's pose in the machine's own coordinates.

    Parameters
    ----------
    machine_T_part : RigidTransform
        The absolute pose: in a machine without errors.
    targets_mm : (T, 3) array
        Targets, part frame.
    target_of : (N,) array of int
        Row in ``targets_mm`` of each target that was seen, once for each image of it.
    geometry_mm : (N, 3) array
        The geometry's error (true minus commanded place of the spindle, machine frame) at the
        stop of that image. Not the stop's own noise.

    Raises
    ------
    InputError
        Where fewer than three targets, or targets on a line, were seen.
    """
    return geometry_fit(machine_T_part, targets_mm, target_of, geometry_mm) @ machine_T_part


def geometry_fit(
    machine_T_part: RigidTransform,
    targets_mm: ArrayLike,
    target_of: ArrayLike,
    geometry_mm: ArrayLike,
) -> RigidTransform:
    """Return ``own_T_machine``: what takes the targets P best to where the machine meets them.

    Arguments and errors are those of :func:`own_pose`. Least squares of all rotations by singular
    value decomposition (Arun, Huang and Blostein 1987, with Umeyama's sign, 1991).
    """
    index = np.asarray(target_of)
    errors = np.asarray(geometry_mm, dtype=float)
    seen = np.unique(index)
    mean = np.array([errors[index == target].mean(axis=0) for target in seen]).reshape(-1, 3)
    P = machine_T_part @ np.asarray(targets_mm, dtype=float)[seen]
    met = P - mean
    centre, met_centre = P.mean(axis=0), met.mean(axis=0)
    spread = np.linalg.svd(P - centre, compute_uv=False)
    if len(seen) < 3 or spread[1] < 1e-6 * spread[0]:
        raise InputError(
            f"Expected at least 3 targets that do not lie on a line, got {len(seen)} targets seen"
            f" in {len(index)} places."
        )
    U, _, Vt = np.linalg.svd((met - met_centre).T @ (P - centre))
    rotation = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return RigidTransform(rotation=rotation, translation_mm=met_centre - rotation @ centre)
