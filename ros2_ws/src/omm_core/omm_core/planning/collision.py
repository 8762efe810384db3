"""Whether the camera's body and the part's box meet.

Both are convex, so that projecting a point to the one and to the other in turn ends in the pair of
points that lie closest (von Neumann; Cheney and Goldstein 1959). Each projection is closed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform
from omm_core.imaging.taking import Body
from omm_core.planning.scene import Scene

Array = NDArray[np.float64]

CLEARANCE_MM = 10.0
"""What is to be left between body and box."""
_ROUNDS = 300
_STILL_MM = 1e-3


def clearance_mm(scene: Scene, machine_T_spindles: list[RigidTransform]) -> Array:
    """Return the distance between the camera's body and the part's box at each stop, (S,), mm.

    0 where they meet. Without a body it is that of the camera's own point.
    """
    part_T_machine = scene.machine_T_part.inverse()
    box = scene.part.box()
    rotations = np.array([part_T_machine.rotation @ s.rotation for s in machine_T_spindles])
    places = np.array([part_T_machine @ s.translation_mm for s in machine_T_spindles])
    body = scene.calibration.body
    if body is None:
        eye = places + rotations @ scene.spindle_T_camera.translation_mm
        return np.asarray(np.linalg.norm(eye - np.clip(eye, box[0], box[1]), axis=1))
    # The body is round about the taper's z, which is the spindle's.
    point = np.tile(box.mean(axis=0), (len(places), 1))
    before = np.full(len(places), np.inf)
    for _ in range(_ROUNDS):
        on_body = _nearest_of_body(body, rotations, places, point)
        point = np.clip(on_body, box[0], box[1])
        distance = np.linalg.norm(on_body - point, axis=1)
        if np.all(before - distance < _STILL_MM):
            break
        before = distance
    return np.asarray(np.where(distance < 0.05, 0.0, distance))


def _nearest_of_body(body: Body, rotations: Array, places: Array, points: Array) -> Array:
    """Return the nearest points of cylinders, all in the part frame, (S, 3)."""
    own = np.einsum("sji,sj->si", rotations, points - places)
    radius = np.maximum(np.linalg.norm(own[:, :2], axis=1), 1e-12)
    own[:, :2] *= np.minimum(1.0, body.radius_mm / radius)[:, None]
    own[:, 2] = np.clip(own[:, 2], *body.z_mm)
    return np.asarray(np.einsum("sij,sj->si", rotations, own) + places)
