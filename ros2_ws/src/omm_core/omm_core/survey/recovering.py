"""Photographs with too few coded targets to stand alone, placed with the help of plain ones.

Three coded targets allow up to four poses (P3P); the right one is where most of the known points,
plain ones among them, have a dot where they would appear.
"""

from __future__ import annotations

from itertools import combinations, islice

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from omm_core.survey.camera_model import lens_pixels, undistorted
from omm_core.survey.network import Network
from omm_core.survey.sighting import CODED, PLAIN, Sighting, sighting_of_dot
from omm_core.targets.plain import PlainDot

Array = NDArray[np.float64]

_FEWEST_CODED = 3
_FEWEST_HITS = 7  # dots where known points would appear, the three included
_TRIPLES = 10
_NEAR_PX, _FINE_PX = 4.0, 1.0
_COSINE = 0.3  # of the angle between a point's normal and the look at it, at least


def recovered(
    network: Network, sightings: list[Sighting], dots: dict[int, tuple[PlainDot, ...]]
) -> tuple[dict[int, Array], list[Sighting]]:
    """Return poses (6,) of photographs that are not yet placed, and what more they show."""
    poses: dict[int, Array] = {}
    more: list[Sighting] = []
    for photo, found in dots.items():
        coded = [s for s in sightings if s.photo == photo and s.point in network.points]
        if photo in network.photos or len(coded) < _FEWEST_CODED or not found:
            continue
        placed = _placed(network, coded, found)
        if placed is not None:
            pose, hits = placed
            poses[photo] = pose
            read = {s.point for s in coded}
            more += [
                sighting_of_dot(photo, point, found[dot], PLAIN if point < 0 else CODED)
                for point, dot in hits.items()
                if point not in read
            ]
    return poses, more


def _placed(
    network: Network, coded: list[Sighting], dots: tuple[PlainDot, ...]
) -> tuple[Array, dict[int, int]] | None:
    import cv2

    pixels = np.array([dot.center_px for dot in dots])
    tree = cKDTree(pixels)
    ideal = undistorted(network.lens, np.array([s.center_px for s in coded]) - network.middle_px)
    places = np.array([network.xyz_mm(s.point) for s in coded])
    best: tuple[int, Array] | None = None
    for triple in islice(combinations(range(len(coded)), 3), _TRIPLES):
        rows = list(triple)
        _, turns, shifts = cv2.solveP3P(
            places[rows], ideal[rows], np.eye(3), None, flags=cv2.SOLVEPNP_P3P
        )
        for turn, shift in zip(turns, shifts, strict=True):
            pose = _pose(turn, shift)
            count = len(_hits(network, pose, tree, _NEAR_PX))
            if best is None or count > best[0]:
                best = (count, pose)
    if best is None or best[0] < _FEWEST_HITS - _FEWEST_CODED:
        return None
    pose = best[1]
    known = {s.point: s.center_px for s in coded}
    for near in (_NEAR_PX, 2 * _FINE_PX, _FINE_PX):
        hits = _hits(network, pose, tree, near)
        seen = {**{point: pixels[dot] for point, dot in hits.items()}, **known}
        if len(seen) < _FEWEST_HITS:
            return None
        rays = undistorted(network.lens, np.array(list(seen.values())) - network.middle_px)
        at = np.array([network.xyz_mm(point) for point in seen])
        turn = pose[:3].copy()
        shift = -Rotation.from_rotvec(turn).apply(pose[3:])
        turn, shift = cv2.solvePnPRefineLM(at, rays, np.eye(3), None, turn, shift)
        pose = _pose(turn, shift)
    off = cv2.projectPoints(at, turn, shift, np.eye(3), None)[0][:, 0] - rays
    if float(np.median(np.abs(off))) * network.lens[0] > 0.5 * _FINE_PX:
        return None
    return pose, _hits(network, pose, tree, _FINE_PX)


def _pose(turn: Array, shift: Array) -> Array:
    rotation = Rotation.from_rotvec(np.asarray(turn, dtype=float).ravel())
    return np.r_[rotation.as_rotvec(), -rotation.inv().apply(np.asarray(shift).ravel())]


def _hits(network: Network, pose: Array, tree: cKDTree, near_px: float) -> dict[int, int]:
    """Return the dot of each known point that faces the camera and has one where it appears."""
    numbers = list(network.points)
    points = network.solution.values["points"]
    inside = Rotation.from_rotvec(pose[:3]).apply(points - pose[3:])
    depth = inside[:, 2]
    safe = np.where((depth > 0)[:, None], inside, [0.0, 0.0, 1.0])
    pixels = lens_pixels(network.lens, safe) + network.middle_px
    apart, which = tree.query(pixels, distance_upper_bound=near_px)
    hits: dict[int, tuple[float, int]] = {}
    for row in np.flatnonzero(np.isfinite(apart) & (depth > 0)):
        number = numbers[row]
        towards = pose[3:] - points[row]
        circle = network.circles.get(number)
        if circle is not None and circle.normal @ towards < _COSINE * np.linalg.norm(towards):
            continue
        dot = int(which[row])
        if dot not in hits or apart[row] < hits[dot][0]:
            hits[dot] = (float(apart[row]), number)
    return {number: dot for dot, (_, number) in hits.items()}
