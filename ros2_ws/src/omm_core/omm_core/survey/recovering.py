"""Photographs with too few coded targets to stand alone, placed with the help of plain ones.

Three coded targets allow up to four poses (P3P); the right one is where most of the known points,
plain ones among them, have a dot where they would appear. Where plain targets are not yet known, as
on a side that only such photographs and two others show, the places where two rays meet stand in
for them: few of these are targets, but hardly any that is not has a dot where it would appear.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, islice

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from omm_core.survey.camera_model import lens_pixels, undistorted
from omm_core.survey.network import Network
from omm_core.survey.sighting import Sighting
from omm_core.targets.plain import PlainDot

Array = NDArray[np.float64]

_FEWEST_CODED = 3
_FEWEST_HITS = 7  # dots where known points would appear, the three included
_TRIPLES = 10
_NEAR_PX, _FINE_PX = 4.0, 1.0
_COSINE = 0.3  # of the angle between a point's normal and the look at it, at least


@dataclass(frozen=True, kw_only=True, eq=False)
class _Places:
    """Where dots may be expected: numbers (n,), 0 for two rays that meet; places and normals."""

    numbers: NDArray[np.intp]
    xyz_mm: Array
    normals: Array  # NaN where not known
    lens: Array
    middle_px: Array


def recovered(
    network: Network,
    sightings: list[Sighting],
    dots: dict[int, tuple[PlainDot, ...]],
    meetings_mm: Array,
) -> dict[int, Array]:
    """Return poses (6,) of photographs that are not yet placed.

    Parameters
    ----------
    meetings_mm : (N, 3) array
        Where two rays to plain dots meet.
    """
    poses: dict[int, Array] = {}
    there = _places(network, meetings_mm)
    for photo, coded in placeable(network, sightings, dots).items():
        there = replace(there, lens=network.lens_of(photo))
        pose = _pose_by_dots(network, there, coded, dots[photo])
        if pose is not None:
            poses[photo] = pose
    return poses


def placeable(
    network: Network, sightings: list[Sighting], dots: dict[int, tuple[PlainDot, ...]]
) -> dict[int, list[Sighting]]:
    """Return the photographs that are not placed but show coded targets enough, and these."""
    coded: dict[int, list[Sighting]] = {}
    for s in sightings:
        if s.photo not in network.photos and s.point in network.points and dots.get(s.photo):
            coded.setdefault(s.photo, []).append(s)
    return {photo: shown for photo, shown in coded.items() if len(shown) >= _FEWEST_CODED}


def _places(network: Network, meetings_mm: Array) -> _Places:
    numbers = list(network.points)
    unknown = np.full(3, np.nan)
    normals = [network.circles[n].normal if n in network.circles else unknown for n in numbers]
    return _Places(
        numbers=np.array([*numbers, *[0] * len(meetings_mm)], dtype=np.intp),
        xyz_mm=np.vstack([network.solution.values["points"], meetings_mm]),
        normals=np.vstack([*normals, np.full((len(meetings_mm), 3), np.nan)]),
        lens=network.lens,
        middle_px=network.middle_px,
    )


def _pose_by_dots(
    network: Network, there: _Places, coded: list[Sighting], dots: tuple[PlainDot, ...]
) -> Array | None:
    import cv2

    pixels = np.array([dot.center_px for dot in dots])
    tree = cKDTree(pixels)
    read = np.array([s.center_px for s in coded])
    ideal = undistorted(there.lens, read - network.middle_px)
    places = np.array([network.xyz_mm(s.point) for s in coded])
    best: tuple[int, Array] | None = None
    for triple in islice(combinations(range(len(coded)), 3), _TRIPLES):
        rows = list(triple)
        _, turns, shifts = cv2.solveP3P(
            places[rows], ideal[rows], np.eye(3), None, flags=cv2.SOLVEPNP_P3P
        )
        for turn, shift in zip(turns, shifts, strict=True):
            pose = _pose(turn, shift)
            count = len(_hits(there, pose, tree, _NEAR_PX))
            if best is None or count > best[0]:
                best = (count, pose)
    if best is None or best[0] < _FEWEST_HITS - _FEWEST_CODED:
        return None
    pose = best[1]
    for near in (_NEAR_PX, 2 * _FINE_PX, _FINE_PX):
        hits = _hits(there, pose, tree, near)
        # A coded target that lies elsewhere was read wrong, or moved.
        fits = np.linalg.norm(_seen(there, places, pose)[0] - read, axis=1) < near
        if len(hits) + fits.sum() < _FEWEST_HITS:
            return None
        seen = np.vstack([pixels[list(hits.values())], read[fits]])
        rays = undistorted(there.lens, seen - network.middle_px)
        at = np.vstack([there.xyz_mm[list(hits)], places[fits]])
        turn = pose[:3].copy()
        shift = -Rotation.from_rotvec(turn).apply(pose[3:])
        turn, shift = cv2.solvePnPRefineLM(at, rays, np.eye(3), None, turn, shift)
        pose = _pose(turn, shift)
    off = cv2.projectPoints(at, turn, shift, np.eye(3), None)[0][:, 0] - rays
    if float(np.median(np.abs(off))) * there.lens[0] > 0.5 * _FINE_PX:
        return None
    return pose


def _pose(turn: Array, shift: Array) -> Array:
    rotation = Rotation.from_rotvec(np.asarray(turn, dtype=float).ravel())
    return np.r_[rotation.as_rotvec(), -rotation.inv().apply(np.asarray(shift).ravel())]


def _seen(there: _Places, points: Array, pose: Array) -> tuple[Array, Array]:
    """Return where points appear, px, and their depth."""
    inside = Rotation.from_rotvec(pose[:3]).apply(points - pose[3:])
    depth = inside[:, 2]
    safe = np.where((depth > 0)[:, None], inside, [0.0, 0.0, 1.0])
    return lens_pixels(there.lens, safe) + there.middle_px, depth


def _hits(there: _Places, pose: Array, tree: cKDTree, near_px: float) -> dict[int, int]:
    """Return the dot of each place that faces the camera and has one where it appears.

    Each dot stands for one place only: a known point before a meeting of two rays, the nearest.
    """
    pixels, depth = _seen(there, there.xyz_mm, pose)
    apart, which = tree.query(pixels, distance_upper_bound=near_px)
    towards = pose[3:] - there.xyz_mm
    away = np.einsum("ni,ni->n", there.normals, towards) < _COSINE * np.linalg.norm(towards, axis=1)
    hits: dict[int, tuple[bool, float, int]] = {}
    for row in np.flatnonzero(np.isfinite(apart) & (depth > 0) & ~away):
        worth = (bool(there.numbers[row] == 0), float(apart[row]), int(row))
        dot = int(which[row])
        hits[dot] = min(worth, hits.get(dot, worth))
    return {row: dot for dot, (_, _, row) in hits.items()}
