"""Which face each measured point lies on, and which points lie on none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.overstock.face import Face

Array = NDArray[np.float64]
Pose = tuple[Array, Array]
# A foil leans with the raw surface; a face that leans more than 45 degrees away is another one.
LEAN = 0.7
NEAR_MM = 30.0
TIMES_MEDIAN = 6.0
SPREADS = 8.0
OUTLIER_MM = 3.0
FEWEST_ON_FACE = 6
MOST_OUTLIERS = 0.15
ALIKE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Points:
    """Points on raw surfaces: names; xyz (N, 3) mm and normals (N, 3) in the survey frame.

    A normal that is not known is nan.
    """

    names: tuple[str, ...]
    xyz: Array
    normals: Array

    def placed(self, pose: Pose) -> tuple[Array, Array]:
        """Return places and normals in the part frame."""
        return self.xyz @ pose[0].T + pose[1], self.normals @ pose[0].T

    def only(self, chosen: NDArray[np.bool_]) -> Points:
        """Return some of them."""
        names = tuple(n for n, good in zip(self.names, chosen, strict=True) if good)
        return Points(names=names, xyz=self.xyz[chosen], normals=self.normals[chosen])


@dataclass(frozen=True, kw_only=True, eq=False)
class Assignment:
    """The face of each point (-1: none), how far it is, and another that is as near (-1: none)."""

    face: NDArray[np.int64]
    distance: Array
    other: NDArray[np.int64]


def assign(faces: tuple[Face, ...], points: Points, pose: Pose) -> Assignment:
    """Assign each point to the nearest face that looks its way."""
    placed, normals = points.placed(pose)
    known = np.asarray(np.isfinite(normals).all(axis=1))
    best, second = np.full(len(placed), np.inf), np.full(len(placed), np.inf)
    chosen = np.full(len(placed), -1, dtype=np.int64)
    other = chosen.copy()
    # Faces of many triangles last: most points have found a nearer one by then.
    for number in sorted(range(len(faces)), key=lambda n: len(faces[n].triangles)):
        face = faces[number]
        near = np.flatnonzero(face.index.box_distance(placed) < np.where(known, best, second))
        if len(near) == 0:
            continue
        distance, outward = face.nearest(placed[near])
        if face.kind != "free":
            outward = face.distance(placed[near])[1]
        lean = (outward * normals[near]).sum(axis=1)
        distance = np.where(known[near] & (lean < LEAN), np.inf, distance)
        nearer = distance < best[near]
        later = ~nearer & (distance < second[near])
        other[near[nearer]], other[near[later]] = chosen[near[nearer]], number
        second[near] = np.where(nearer, best[near], np.minimum(second[near], distance))
        best[near] = np.where(nearer, distance, best[near])
        chosen[near[nearer]] = number
    chosen[~np.isfinite(best)] = -1
    # Where the normal tells, two faces can be as near only where they meet smoothly.
    gap = second - np.where(np.isfinite(best), best, 0.0)
    doubtful = ~known & np.isfinite(second) & (gap < ALIKE * (np.minimum(best, 1e9) + 1.0))
    return Assignment(face=chosen, distance=best, other=np.where(doubtful, other, -1))


def without_doubt(faces: tuple[Face, ...], given: Assignment, placed: Array) -> Assignment:
    """Assign points beyond an edge, as near to two faces, to the one whose points they continue.

    ``other`` stays where both would do, or where they lie far off both.
    """
    face, other = given.face.copy(), given.other.copy()
    sure = given.other < 0
    for n in np.flatnonzero(~sure):
        apart = []
        for candidate in (given.face[n], given.other[n]):
            on = np.flatnonzero(sure & (given.face == candidate))
            if len(on) < FEWEST_ON_FACE:
                break
            overstock, _ = faces[candidate].distance(placed[[*on, n]])
            told = _smooth(faces[candidate], placed[on], overstock[:-1], at=placed[[n]])
            apart.append(abs(float(overstock[-1] - told[0])))
        if len(apart) == 2 and min(apart) < OUTLIER_MM and 2.0 * min(apart) < max(apart):
            face[n] = (given.face[n], given.other[n])[int(np.argmin(apart))]
            other[n] = -1
    return Assignment(face=face, distance=given.distance, other=other)


def off_the_part(assignment: Assignment) -> NDArray[np.bool_]:
    """Return which points are too far from any face that looks their way."""
    on = np.isfinite(assignment.distance)
    if not on.any():
        return np.ones(len(assignment.distance), dtype=bool)
    limit = NEAR_MM + TIMES_MEDIAN * float(np.median(assignment.distance[on]))
    return np.asarray(~(assignment.distance < limit))


def outliers(faces: tuple[Face, ...], face: NDArray[np.int64], placed: Array) -> Array:
    """Return how far each point lies off what the others on its face tell; 0 where that is little.

    Parameters
    ----------
    face : (N,) array of int
        Face of each point.
    placed : (N, 3) array
        Places in the part frame.
    """
    off = np.zeros(len(placed))
    for number in np.unique(face):
        on = np.flatnonzero(face == number)
        if len(on) < FEWEST_ON_FACE:
            continue
        overstock, _ = faces[number].distance(placed[on])
        apart = overstock - _smooth(faces[number], placed[on], overstock)
        spread = 1.4826 * float(np.median(np.abs(apart)))
        strange = np.abs(apart) > max(SPREADS * spread, OUTLIER_MM)
        if 0 < strange.sum() <= max(1, MOST_OUTLIERS * len(on)):
            off[on[strange]] = apart[strange]
    return off


def _smooth(face: Face, placed: Array, overstock: Array, at: Array | None = None) -> Array:
    """Return what a raw face that may lean tells of its overstock, whatever a few points say.

    At the points themselves, or at other places.
    """
    wanted = placed if at is None else at
    if face.kind != "plane":
        return np.full(len(wanted), np.median(overstock))
    centre = placed.mean(axis=0)
    arms = placed - centre
    _, values, axes = np.linalg.svd(arms - np.outer(arms @ face.axis, face.axis))
    size = max(float(values[0]), 1e-9)
    rows = np.hstack([np.ones((len(placed), 1)), arms @ axes[:2].T / size])
    weights = np.ones(len(placed))
    for _ in range(20):
        answer = np.linalg.lstsq(rows * weights[:, None], overstock * weights, rcond=1e-9)[0]
        apart = np.abs(overstock - rows @ answer)
        weights = 1.0 / np.sqrt(np.maximum(apart, 1e-3 + 0.1 * float(np.median(apart))))
    lever = (wanted - centre) @ axes[:2].T / size
    return np.asarray(answer[0] + lever @ answer[1:])
