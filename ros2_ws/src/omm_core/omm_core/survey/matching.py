"""Which plain dots of different photographs are the same target.

With the photographs placed by coded targets, every pair of dots in two photographs whose rays meet
is a hypothesis: a place. Its support is how many other photographs show a dot of the right size
where it would appear. The best supported is taken first and claims its dots, so that what is left
of chance intersections finds no third ray any more.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from omm_core.survey.camera_model import lens_pixels, undistorted
from omm_core.targets.plain import PlainDot

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_EPIPOLAR_PX = 0.8
_NEAR_PX = 1.0  # of a place from two rays
_FITS_PX = 0.35  # of a ray from the place of all
_SIZES = 1.4  # ratio of two measures of a dot's diameter
_ANGLES = (0.10, 2.2)  # rad between two rays
_NARROW = 0.02  # rad: tells at least where to look
_PARTNERS = 24  # photographs that each is paired with
FEWEST = 3
_SPREAD = 0.12  # rad: largest angle among the rays of a target, at least


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedPhoto:
    """A photograph with its dots.

    Attributes
    ----------
    number : int
    turn, place : camera_R_survey (3, 3) and (3,) mm
    lens : (10,) array
    dots : what was found in it and is not yet claimed
    """

    number: int
    turn: Array
    place: Array
    lens: Array
    dots: tuple[PlainDot, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Match:
    """A target: its place and its dot in each photograph (photo number -> position in dots)."""

    xyz_mm: Array
    dots: dict[int, int]


class _Scene:
    """Rays of all dots, in one list; `first[k]` is where those of photograph k begin."""

    def __init__(self, photos: list[PlacedPhoto], middle_px: Array) -> None:
        self.photos, self.middle = photos, middle_px
        self.lenses = np.array([p.lens for p in photos])
        self.focal = self.lenses[:, 0]
        counts = [len(p.dots) for p in photos]
        self.first = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
        every = [dot for p in photos for dot in p.dots]
        self.pixels = np.array([dot.center_px for dot in every]).reshape(-1, 2)
        self.photo = np.repeat(np.arange(len(photos)), counts)
        ideal = undistorted(self.lenses[self.photo], self.pixels - middle_px)
        inside = np.column_stack([ideal, np.ones(len(ideal))])
        self.size = np.array(
            [2.0 * np.sqrt(np.linalg.eigvalsh(dot.spread_px2)[1]) for dot in every]
        )
        self.turns = np.array([p.turn for p in photos])
        looks = np.einsum("mji,mj->mi", self.turns[self.photo], inside)
        self.looks = looks / np.linalg.norm(looks, axis=1, keepdims=True)
        self.places = np.array([p.place for p in photos])
        self.trees = [
            cKDTree(self.pixels[self.first[k] : self.first[k + 1]]) if n else None
            for k, n in enumerate(counts)
        ]

    def dots_at(self, place: Array) -> Index:
        """Return the dot of each photograph where a place would appear, -1 where there is none."""
        inside = np.einsum("kij,kj->ki", self.turns, place - self.places)
        before = inside[:, 2] > 0
        pixels = lens_pixels(self.lenses[before], inside[before]) + self.middle
        found = np.full(len(self.photos), -1, dtype=np.intp)
        for k, at in zip(np.flatnonzero(before), pixels, strict=True):
            tree = self.trees[k]
            if tree is not None:
                apart, near = tree.query(at, distance_upper_bound=_NEAR_PX)
                if np.isfinite(apart):
                    found[k] = self.first[k] + near
        return found

    def seen(self, k: int, points: Array) -> tuple[Array, Array]:
        """Return pixels (N, 2) of points in photograph k, and their depth."""
        inside = (points - self.places[k]) @ self.photos[k].turn.T
        depth = inside[:, 2]
        safe = np.where((depth > 0)[:, None], inside, [0.0, 0.0, 1.0])
        return lens_pixels(self.lenses[k], safe) + self.middle, depth


def match_dots(
    photos: list[PlacedPhoto],
    middle_px: Array,
    box_mm: Array,
    diameter_mm: float | None,
) -> list[Match]:
    """Return the targets that three or more photographs agree on, best supported first.

    Parameters
    ----------
    photos : list of PlacedPhoto
    box_mm : (2, 3) array
        Where targets can be.
    diameter_mm : float or None
        Of the dots, where it is known.
    """
    if sum(len(p.dots) > 0 for p in photos) < FEWEST:
        return []
    scene = _Scene(photos, middle_px)
    partners = _partners(scene, box_mm)
    pairs, places = _hypotheses(scene, partners, box_mm, diameter_mm, _ANGLES[0])
    support = _support(scene, places)
    free = np.ones(len(scene.pixels), dtype=bool)
    found = []
    for i in np.argsort(-support, kind="stable"):
        if support[i] < FEWEST:
            break
        if not free[pairs[i]].all():
            continue
        match = _grown(scene, places[i], free, diameter_mm)
        if match is not None:
            place, dots = match
            free[dots] = False
            found.append(
                Match(
                    xyz_mm=place,
                    dots={
                        photos[scene.photo[d]].number: int(d - scene.first[scene.photo[d]])
                        for d in dots
                    },
                )
            )
    return found


def meetings(
    photos: list[PlacedPhoto],
    middle_px: Array,
    box_mm: Array,
    diameter_mm: float | None,
) -> Array:
    """Return where two rays meet at any angle, (N, 3): targets, and much that is none.

    Parameters are those of `match_dots`.
    """
    if sum(len(p.dots) > 0 for p in photos) < 2:
        return np.empty((0, 3))
    scene, pairs = _Scene(photos, middle_px), list(combinations(range(len(photos)), 2))
    return _hypotheses(scene, pairs, box_mm, diameter_mm, _NARROW)[1]


def _partners(scene: _Scene, box_mm: Array) -> list[tuple[int, int]]:
    """Return pairs of photographs that look from different sides, not too different ones."""
    towards = box_mm.mean(axis=0) - scene.places
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    angles = np.arccos(np.clip(towards @ towards.T, -1.0, 1.0))
    pairs = set()
    for k in range(len(scene.photos)):
        good = np.argsort(np.abs(angles[k] - 0.5), kind="stable")
        for other in [int(j) for j in good if j != k][:_PARTNERS]:
            pairs.add((min(k, other), max(k, other)))
    return sorted(pairs)


def _hypotheses(
    scene: _Scene,
    partners: list[tuple[int, int]],
    box_mm: Array,
    diameter_mm: float | None,
    least_angle: float,
) -> tuple[NDArray[np.intp], Array]:
    """Return pairs of dots (N, 2) whose rays meet, and where, (N, 3)."""
    pairs, places = [np.empty((0, 2), dtype=np.intp)], [np.empty((0, 3))]
    for a, b in partners:
        one = np.arange(scene.first[a], scene.first[a + 1])
        two = np.arange(scene.first[b], scene.first[b + 1])
        base = scene.places[b] - scene.places[a]
        if not len(one) or not len(two) or not np.linalg.norm(base) > 0.0:
            continue
        normal = np.cross(base, scene.looks[one])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        off = np.abs(normal @ scene.looks[two].T) * 0.5 * (scene.focal[a] + scene.focal[b])
        i, j = np.nonzero(off < _EPIPOLAR_PX)
        one, two = one[i], two[j]
        place, depths, angle = _meeting(scene, one, two, base)
        sizes = [
            scene.size[d] * depth / scene.focal[k]
            for d, depth, k in ((one, depths[0], a), (two, depths[1], b))
        ]
        good = (depths[0] > 0) & (depths[1] > 0) & (angle > least_angle) & (angle < _ANGLES[1])
        good &= ((place > box_mm[0]) & (place < box_mm[1])).all(axis=1)
        good &= np.maximum(sizes[0], sizes[1]) < _SIZES * np.minimum(sizes[0], sizes[1])
        if diameter_mm is not None:
            good &= _is_size(sizes[0], diameter_mm) & _is_size(sizes[1], diameter_mm)
        pairs.append(np.stack([one, two], axis=1)[good])
        places.append(place[good])
    return np.concatenate(pairs), np.concatenate(places)


def _is_size(measured: Array, diameter_mm: float) -> NDArray[np.bool_]:
    return np.asarray((measured < _SIZES * diameter_mm) & (measured * _SIZES > diameter_mm))


def _meeting(
    scene: _Scene, one: Index, two: Index, base: Array
) -> tuple[Array, tuple[Array, Array], Array]:
    """Return where pairs of rays come closest, their lengths there, and the angle between them."""
    d, e = scene.looks[one], scene.looks[two]
    cosine = np.einsum("ni,ni->n", d, e)
    square = np.maximum(1.0 - cosine**2, 1e-12)
    s = (d @ base - cosine * (e @ base)) / square
    t = (cosine * (d @ base) - e @ base) / square
    a, b = scene.places[scene.photo[one]], scene.places[scene.photo[two]]
    place = 0.5 * (a + s[:, None] * d + b + t[:, None] * e)
    return place, (s, t), np.arccos(np.clip(cosine, -1.0, 1.0))


def _support(scene: _Scene, places: Array) -> Index:
    """Return in how many photographs a dot lies where each place would appear."""
    support = np.zeros(len(places), dtype=np.intp)
    for k, tree in enumerate(scene.trees):
        if tree is not None and len(places):
            pixels, depth = scene.seen(k, places)
            apart, _ = tree.query(pixels, distance_upper_bound=_NEAR_PX)
            support += np.isfinite(apart) & (depth > 0)
    return support


def _grown(
    scene: _Scene, place: Array, free: NDArray[np.bool_], diameter_mm: float | None
) -> tuple[Array, Index] | None:
    """Return the place from all rays that fit, and their dots; None where three do not."""
    for _ in range(3):
        dots = scene.dots_at(place)
        dots = dots[dots >= 0]
        dots = dots[free[dots]]
        fitted = _place_of(scene, dots)
        if fitted is None:
            return None
        place, dots = fitted
    depth = np.linalg.norm(place - scene.places[scene.photo[dots]], axis=1)
    sizes = scene.size[dots] * depth / scene.focal[scene.photo[dots]]
    middle = float(np.median(sizes))
    fits = np.maximum(sizes, middle) < _SIZES * np.minimum(sizes, middle)
    if diameter_mm is not None and not _is_size(np.array([middle]), diameter_mm).all():
        return None
    if fits.sum() < FEWEST or _widest(scene.looks[dots[fits]]) < _SPREAD:
        return None
    return place, dots[fits]


def _place_of(scene: _Scene, dots: Index) -> tuple[Array, Index] | None:
    """Intersect rays, leaving out the worst until all fit."""
    while len(dots) >= FEWEST:
        looks, at = scene.looks[dots], scene.places[scene.photo[dots]]
        across = np.eye(3) - looks[:, :, None] * looks[:, None, :]
        away = np.full(len(dots), 1.0)
        for _ in range(2):  # weights: errors are those of pixels, not of mm
            weighted = across / away[:, None, None] ** 2
            normal = weighted.sum(axis=0)
            if np.linalg.cond(normal) > 1e8:
                return None
            place = np.linalg.solve(normal, np.einsum("nij,nj->i", weighted, at))
            away = np.linalg.norm(place - at, axis=1)
        off = np.linalg.norm(np.einsum("nij,nj->ni", across, place - at), axis=1) / away
        off_px = off * scene.focal[scene.photo[dots]]
        if off_px.max() <= _FITS_PX:
            return place, dots
        dots = np.delete(dots, int(np.argmax(off_px)))
    return None


def _widest(looks: Array) -> float:
    return float(np.arccos(np.clip(looks @ looks.T, -1.0, 1.0)).max())


def placed(number: int, pose: Array, lens: Array, dots: tuple[PlainDot, ...]) -> PlacedPhoto:
    """Return a photograph with its pose (6,): rotation vector, place."""
    turn = Rotation.from_rotvec(pose[:3]).as_matrix()
    return PlacedPhoto(number=number, turn=turn, place=np.array(pose[3:]), lens=lens, dots=dots)
