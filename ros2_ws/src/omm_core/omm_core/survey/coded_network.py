"""The network of coded targets, from nothing but about how long the focal length is."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import MeasurementError
from omm_core.survey.camera_model import undistorted
from omm_core.survey.cameras import Cameras, pixel_of
from omm_core.survey.fitting import adjusted
from omm_core.survey.network import (
    Network,
    NetworkState,
    stages_for,
    state_of,
)
from omm_core.survey.sighting import Bar, Sighting
from omm_core.survey.start import (
    Rays,
    intersect_points,
    resect_photos,
    start_network,
)

Array = NDArray[np.float64]

_ANGLE_RAD = 0.02  # between rays, once the lens is known
_FOCAL_TRIED = (1.0, 0.8, 1.25, 0.65, 1.5)
_GOOD_PX, _USABLE_PX = 0.3, 3.0  # rms of a start
_TRIES = 3  # to place a photograph or a point
_GOOD_SHARE = 0.5  # of the photographs
LOOSE = (
    "The photographs are not connected: expected each to show four or more targets that others"
    " also show, from other sides. Take more, with more overlap."
)


def started(
    sightings: list[Sighting],
    bars: list[Bar],
    cameras: Cameras,
    middle: Array,
    declared: dict[str, float],
) -> Network:
    """Return the network of coded targets, though the focal length be told quite wrong."""
    if not sightings:
        raise MeasurementError("Expected coded targets in the photographs; none was read.")
    best: Network | None = None
    reason: Exception | None = None
    for factor in _FOCAL_TRIED:
        try:
            found = _coded_network(sightings, bars, cameras, factor, middle, declared)
        except (MeasurementError, np.linalg.LinAlgError, ValueError) as error:
            reason = reason or error
            continue
        if best is None or _worth(found) > _worth(best):
            best = found
        if found.rms_px < _GOOD_PX and len(found.photos) >= _GOOD_SHARE * len(
            {s.photo for s in sightings}
        ):
            break
    if best is not None and best.rms_px < _USABLE_PX:
        return best
    if best is None and isinstance(reason, MeasurementError):
        raise reason
    raise MeasurementError(LOOSE)


def _worth(network: Network) -> float:
    """Return how good a start is: rays that fit, the more the better."""
    return float(network.used.sum()) / (1.0 + network.rms_px)


def _coded_network(
    sightings: list[Sighting],
    bars: list[Bar],
    cameras: Cameras,
    factor: float,
    middle: Array,
    declared: dict[str, float],
) -> Network:
    """Return the network of coded targets: a start, then photographs and points by turns.

    No bar takes part: a wrong one would bend all rays. They only tell how large it is, about.
    """
    state = NetworkState(
        lenses=cameras.lenses(factor), cameras=cameras, photos={}, points={}, declared_mm=declared
    )
    photos, points = start_network(rays_by_photo(sightings, state, middle), pixel_of(state.lenses))
    points = _seen_by(3, points, photos, sightings)
    state = _scaled(replace(state, photos=photos, points=points), bars)
    network = adjusted(state, sightings, [], middle, stages_for(len(photos)))
    tries: Counter[tuple[str, int]] = Counter()
    while True:
        given_up = {what for what, count in tries.items() if count >= _TRIES}
        state = _extended(_scaled(state_of(network, declared), bars), sightings, middle, given_up)
        new = {("photo", n) for n in state.photos.keys() - network.photos.keys()}
        new |= {("point", n) for n in state.points.keys() - network.points.keys()}
        if not new:
            break
        tries.update(new)
        stage = stages_for(len(state.photos))[-1:]
        try:
            network = adjusted(state, sightings, [], middle, stage)
        except np.linalg.LinAlgError:
            # Something new is not held by its rays: go on without; what is good is placed later.
            tries.update(dict.fromkeys(new, _TRIES))
    return network


def _extended(
    state: NetworkState, sightings: list[Sighting], middle: Array, given_up: set[tuple[str, int]]
) -> NetworkState:
    """Return the state with more photographs or, where there are none, with more points."""
    photos, points = dict(state.photos), dict(state.points)
    rays, pixel = rays_by_photo(sightings, state, middle), pixel_of(state.lenses)
    wanted = {n: r for n, r in rays.items() if ("photo", n) not in given_up}
    resect_photos(wanted, photos, points, pixel)
    if len(photos) == len(state.photos):
        intersect_points(rays, photos, points, pixel, _ANGLE_RAD)
        new = {p: x for p, x in points.items() if p in state.points or ("point", p) not in given_up}
        points = {**state.points, **_seen_by(2, new, photos, sightings)}
    return replace(state, photos=photos, points=points)


def _seen_by(
    fewest: int, points: dict[int, Array], photos: dict[int, Array], sightings: list[Sighting]
) -> dict[int, Array]:
    counts: dict[int, int] = {}
    for s in sightings:
        counts[s.point] = counts.get(s.point, 0) + (s.photo in photos)
    return {p: xyz for p, xyz in points.items() if counts[p] >= fewest}


def _scaled(state: NetworkState, bars: list[Bar]) -> NetworkState:
    """Return the state in mm, where a bar is seen."""
    at = state.points
    there = [b for b in bars if b.ends[0] in at and b.ends[1] in at]
    if not there:
        return state
    spans = [np.linalg.norm(at[b.ends[0]] - at[b.ends[1]]) for b in there]
    scale = float(np.median([b.length_mm / span for b, span in zip(there, spans, strict=True)]))
    stretch = np.r_[1.0, 1.0, 1.0, scale, scale, scale]
    return replace(
        state,
        photos={n: p * stretch for n, p in state.photos.items()},
        points={n: p * scale for n, p in at.items()},
    )


def rays_by_photo(sightings: list[Sighting], state: NetworkState, middle: Array) -> Rays:
    """Return the undistorted direction of each sighting, by photograph and point."""
    lenses = state.lenses[state.cameras.rows(s.photo for s in sightings)]
    ideal = undistorted(lenses, np.array([s.center_px for s in sightings]) - middle)
    rays: Rays = {}
    for sighting, ray in zip(sightings, ideal, strict=True):
        rays.setdefault(sighting.photo, {})[sighting.point] = ray
    return rays
