"""Plain targets joined to a network of coded ones, and with their help what it could not place."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omm_core.survey.camera_model import project
from omm_core.survey.cameras import pixel_of
from omm_core.survey.coded_network import rays_by_photo
from omm_core.survey.fitting import adjusted
from omm_core.survey.matching import match_dots, meetings, placed
from omm_core.survey.moved_dots import words_of_lost
from omm_core.survey.network import FEWEST_RAYS, Network, NetworkState, stages_for, state_of
from omm_core.survey.recovering import placeable, recovered
from omm_core.survey.sighting import CODED, PLAIN, Bar, Sighting, sighting_of_dot
from omm_core.survey.start import intersect_points
from omm_core.targets.plain import PlainDot

Array = NDArray[np.float64]
Dots = dict[int, tuple[PlainDot, ...]]

_CLAIM_PX = 1.5  # a dot so near to where a known target must be is that target
_RING = 3.6  # times the radius of a coded dot: nothing within is a plain target
_ANGLE_RAD = 0.02  # between rays, once the lens is known
_TRIES = 3  # to place photographs
_MARGIN = 0.3  # of the coded targets' box, on each side, where plain ones may be


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What the photographs show: coded targets, bars, plain dots by photograph; declared sizes."""

    sightings: list[Sighting]
    bars: list[Bar]
    dots: Dots
    declared_mm: dict[str, float]


def with_dots(
    network: Network, found: Found, more: dict[int, Array] | None = None
) -> tuple[Network, list[Sighting]]:
    """Return the network of coded and plain targets together, and all sightings.

    Parameters
    ----------
    more : mapping, optional
        Poses of photographs that are not in the network yet; with it, coded targets that are not
        are located, too.
    """
    state = state_of(network, found.declared_mm)
    state = replace(state, photos={**state.photos, **(more or {})})
    if more is not None:
        coded = _located(state, found.sightings, network.middle_px)
        state = replace(state, points={**coded, **state.points})
    claimed, left = _claimed(state, found, network)
    photos = [
        placed(n, pose, state.lens_of(n), left.get(n, ())) for n, pose in state.photos.items()
    ]
    size = found.declared_mm.get(PLAIN)
    matches = match_dots(photos, network.middle_px, _box(network), size)
    # Numbers of plain points are given anew.
    points = {n: xyz for n, xyz in state.points.items() if n >= 0}
    circles = {n: circle for n, circle in state.circles.items() if n >= 0}
    every = [*found.sightings, *claimed]
    for number, match in enumerate(matches, start=1):
        points[-number] = match.xyz_mm
        every += [
            sighting_of_dot(photo, -number, left[photo][dot]) for photo, dot in match.dots.items()
        ]
    state = replace(state, points=points, circles=circles)
    stages = stages_for(len(state.photos))[-1:]
    joined = adjusted(state, every, found.bars, network.middle_px, stages)
    words = words_of_lost(joined.left_out_points, state, every, joined)
    return replace(joined, words=tuple(words)), every


def with_more_photos(
    network: Network, sightings: list[Sighting], found: Found
) -> tuple[Network, list[Sighting]]:
    """Return the network with photographs that plain targets help to place."""
    for _ in range(_TRIES):
        if not placeable(network, found.sightings, found.dots):
            break
        state = state_of(network, found.declared_mm)
        free = _claimed(state, found, network)[1]
        there = [
            placed(n, pose, state.lens_of(n), free.get(n, ())) for n, pose in state.photos.items()
        ]
        size = found.declared_mm.get(PLAIN)
        where = meetings(there, network.middle_px, _box(network), size)
        poses = recovered(network, found.sightings, found.dots, where)
        if not poses:
            break
        network, _ = with_dots(network, found, poses)
        # Now that they are placed well, what only they and two others see can be matched.
        network, sightings = with_dots(network, found)
    return network, sightings


def lost(network: Network, found: Found) -> bool:
    """Tell whether photographs are missing, or coded targets that three photographs show."""
    rays = Counter(s.point for s in found.sightings)
    points = {n for n, count in rays.items() if count >= FEWEST_RAYS} - network.points.keys()
    return bool(points or placeable(network, found.sightings, found.dots))


def with_lost(network: Network, found: Found) -> tuple[Network, list[Sighting]]:
    """Return the network with all coded targets whose rays meet, and what else it can place now."""
    network, sightings = with_dots(network, found, {})
    return with_more_photos(network, sightings, found)


def _located(state: NetworkState, sightings: list[Sighting], middle: Array) -> dict[int, Array]:
    """Return the places of all coded targets that two photographs or more of a state show."""
    points: dict[int, Array] = {}
    rays = rays_by_photo(sightings, state, middle)
    intersect_points(rays, state.photos, points, pixel_of(state.lenses), _ANGLE_RAD)
    return points


def _box(network: Network) -> Array:
    points = network.solution.values["points"]
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * float((high - low).max())
    return np.array([low - margin, high + margin])


def _claimed(state: NetworkState, found: Found, network: Network) -> tuple[list[Sighting], Dots]:
    """Return coded targets whose ring was not read but whose dot was found; and the dots left.

    What lies within the ring of a known coded target is neither: sectors of its ring.
    """
    claimed: list[Sighting] = []
    left: Dots = {}
    read = {(s.photo, s.point) for s in found.sightings}
    radius = 0.5 * network.diameters_mm.get(CODED, 0.0)
    places = {n: xyz for n, xyz in state.points.items() if n >= 0}
    numbers, xyz = list(places), np.array(list(places.values()))
    rows, first = np.arange(len(numbers)), np.zeros(len(numbers), dtype=np.intp)
    for photo, pose in state.photos.items():
        of_photo = found.dots.get(photo, ())
        if not of_photo:
            continue
        lens = state.lens_of(photo)
        values = {"lens": lens[None], "photos": pose[None], "points": xyz}
        pixels, inside = project(values, first, rows, network.middle_px)
        size = lens[0] * radius / np.maximum(inside[:, 2], 1e-9)
        centres = np.array([d.center_px for d in of_photo])
        apart = np.linalg.norm(centres[:, None] - pixels[None], axis=2)
        apart[:, inside[:, 2] <= 0] = np.inf
        kept = []
        for i, dot in enumerate(of_photo):
            near = int(np.argmin(apart[i]))
            if apart[i, near] < _CLAIM_PX:
                if (photo, numbers[near]) not in read:
                    claimed.append(sighting_of_dot(photo, numbers[near], dot, CODED))
            elif not (apart[i] < _RING * size).any():
                kept.append(dot)
        left[photo] = tuple(kept)
    return claimed, left
