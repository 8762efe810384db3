"""Motions that nothing holds, in words; and whether they matter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.overstock.face import Face
from omm_core.overstock.placement_state import Placement

Array = NDArray[np.float64]
SYMMETRIC = 1e-4
SMALL = 1e-3


def loose_motions(faces: tuple[Face, ...], placement: Placement) -> tuple[list[Array], list[Array]]:
    """Return motions (6,) that nothing holds: those that matter, and those of a symmetric part.

    A turned part may turn about its axis: that changes no face, and the start decides.
    """
    rows = np.vstack([_face_rows(face, placement) for face in faces])
    harmful = [motion for motion in placement.loose]
    harmless: list[Array] = []
    if len(placement.free):
        scale = np.sqrt((rows @ placement.free.T @ placement.free @ rows.T).diagonal().max())
        _, values, axes = np.linalg.svd(rows @ placement.free.T, full_matrices=True)
        values = np.append(values, np.zeros(len(axes) - len(values))) / np.sqrt(len(rows))
        for value, axis in zip(values, axes, strict=True):
            motion = axis @ placement.free
            (harmless if value < SYMMETRIC * max(scale, 1.0) else harmful).append(motion)
    return harmful, harmless


def _face_rows(face: Face, placement: Placement) -> Array:
    """Return how motions change the distance of the face's own places (M, 6)."""
    places = face.triangles.mean(axis=1)
    # A facet of a round face leans off the surface; the surface itself does not.
    if face.kind != "free":
        distance, normals = face.distance(places)
        places = places - distance[:, None] * normals
    else:
        normals = face.normals
    arms = (places - placement.centre_mm) / placement.size_mm
    return np.hstack([normals, np.cross(arms, normals)])


def motion_words(motion: Array, placement: Placement) -> str:
    """Describe a motion (translation, rotation times size about the centroid)."""
    shift, turn = motion[:3], motion[3:] / placement.size_mm
    size = float(np.linalg.norm(turn))
    if size * placement.size_mm < SMALL * max(float(np.linalg.norm(shift)), 1e-12):
        return f"a shift along {_direction(shift)}"
    axis = turn / size
    along = shift @ axis
    place = placement.centre_mm + np.cross(turn, shift - along * axis) / size**2
    at = " ".join(f"{v + 0.0:.0f}" for v in np.round(place))
    words = f"a turn about {_direction(axis)} through ({at})"
    if abs(along) > SMALL * size * placement.size_mm:
        words += f" with a shift of {along / size * 1e-3:.3g} mm per mrad along it"
    return words


def _direction(vector: Array) -> str:
    unit = vector / np.linalg.norm(vector)
    return "(" + " ".join(f"{v + 0.0:.3g}" for v in np.round(unit, 3)) + ")"
