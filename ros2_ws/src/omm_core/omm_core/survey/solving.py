"""A survey from what was seen in its photographs: start, network, plain targets, all together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import MeasurementError
from omm_core.survey.bars import agreeing_bars
from omm_core.survey.camera_model import project
from omm_core.survey.coded_network import LOOSE, rays_by_photo, started
from omm_core.survey.fitting import adjusted
from omm_core.survey.matching import match_dots, placed
from omm_core.survey.network import (
    REJECTION,
    Network,
    stages_for,
    state_of,
)
from omm_core.survey.noise import Noise
from omm_core.survey.recovering import recovered
from omm_core.survey.sighting import CODED, PLAIN, Bar, Sighting, sighting_of_dot
from omm_core.survey.start import (
    FITS_AT_FIRST_PX,
    resect_photos,
)
from omm_core.survey.weeding import Misfits, misfits_of
from omm_core.survey.zooming import zoomed_photos
from omm_core.targets.plain import PlainDot

Array = NDArray[np.float64]
Dots = dict[int, tuple[PlainDot, ...]]

_CLAIM_PX = 1.5  # a dot so near to where a known target must be is that target
_RING = 3.6  # times the radius of a coded dot: nothing within is a plain target
_WEEDINGS = 8
_FEWEST_ZOOMS = 6  # photographs whose focal lengths can be compared
_MARGIN = 0.3  # of the coded targets' box, on each side, where plain ones may be


def solve_network(
    sightings: list[Sighting],
    bars: list[Bar],
    focal_length_px: float,
    size_px: tuple[int, int],
    dots: Dots | None = None,
    diameters_mm: dict[str, float] | None = None,
) -> Network:
    """Adjust from nothing but the nominal focal length.

    Parameters
    ----------
    sightings : list of Sighting
        The coded targets that were read.
    dots : mapping, optional
        Plain dots by photograph.
    diameters_mm : mapping, optional
        Of the dots, by kind; measured where not given.

    Raises
    ------
    MeasurementError
        Where photographs do not hang together, or no bar was measured.
    """
    middle = (np.array(size_px) - 1.0) / 2.0
    declared = diameters_mm or {}
    network = started(sightings, bars, focal_length_px, middle, declared)
    zoomed = _zoomed(network, sightings, declared)
    if zoomed:
        sightings = [s for s in sightings if s.photo not in zoomed]
        network = started(sightings, bars, float(network.lens[0]), middle, declared)
    # A bar's end that moved must not make the bars disagree.
    moved = misfits_of(network).points
    sightings = [s for s in sightings if s.point not in moved]
    try:
        if moved:
            network = _without(network, moved, sightings, declared)
        bars, words = agreeing_bars(network, bars)
        every = sightings
        if dots:
            network, every = _with_dots(network, sightings, bars, dots, declared)
            network, every = _with_more_photos(network, every, bars, dots, declared, zoomed)
        network = _weeded(network, every, bars, declared, Misfits(points=moved, photos=zoomed))
    except np.linalg.LinAlgError:
        raise MeasurementError(LOOSE) from None
    return replace(network, words=(*words, *network.words))


def _zoomed(
    network: Network, sightings: list[Sighting], declared: dict[str, float]
) -> dict[int, str]:
    """Return photographs with another focal length than most, and why that is thought."""
    state = replace(state_of(network, declared), noise=Noise())
    rays, pixel = (
        rays_by_photo(sightings, state.lens, network.middle_px),
        float(1.0 / state.lens[0]),
    )
    # Also those which one focal length for all has thrown out.
    resect_photos(rays, state.photos, state.points, pixel, FITS_AT_FIRST_PX)
    if len(state.photos) < _FEWEST_ZOOMS:
        return {}
    stage = stages_for(len(state.photos))[-1:]
    try:
        free = adjusted(state, sightings, [], network.middle_px, stage, zooms=True)
    except np.linalg.LinAlgError:
        return {}
    return zoomed_photos(free, 1 + max(s.photo for s in sightings))


def _without(
    network: Network,
    points: dict[int, str],
    sightings: list[Sighting],
    declared: dict[str, float],
) -> Network:
    """Return the network of coded targets without some of them."""
    state = state_of(network, declared)
    left = {n: xyz for n, xyz in state.points.items() if n not in points}
    stages = stages_for(len(state.photos))[-1:]
    return adjusted(replace(state, points=left), sightings, [], network.middle_px, stages)


def _weeded(
    network: Network,
    sightings: list[Sighting],
    bars: list[Bar],
    declared: dict[str, float],
    out: Misfits,
) -> Network:
    """Adjust for good; what then still contradicts itself is left out with all of its rays."""
    state = state_of(network, declared)
    for _ in range(_WEEDINGS):
        stages = stages_for(len(state.photos))[-1:]
        network = adjusted(state, sightings, bars, network.middle_px, stages, REJECTION)
        out = out.with_(Misfits(points=network.left_out_points, photos=network.left_out_photos))
        more = misfits_of(network)
        if not more:
            break
        out = out.with_(more)
        state = state_of(network, declared)
        for number in more.points:
            del state.points[number]
        for number in more.photos:
            del state.photos[number]
    told = {
        n: why
        for n, why in out.points.items()
        if n > 0  # plain ones have no name beforehand
    }
    return replace(network, left_out_points=told, left_out_photos=out.photos)


def _with_dots(
    network: Network,
    sightings: list[Sighting],
    bars: list[Bar],
    dots: Dots,
    declared: dict[str, float],
) -> tuple[Network, list[Sighting]]:
    """Return the network of coded and plain targets together, and all sightings."""
    claimed, left = _claimed(network, sightings, dots)
    box = _box(network)
    photos = [placed(n, network.pose(n), left.get(n, ())) for n in network.photos]
    matches = match_dots(photos, network.lens, network.middle_px, box, declared.get(PLAIN))
    state = state_of(network, declared)
    # Numbers of plain points are given anew.
    points = {n: xyz for n, xyz in state.points.items() if n > 0}
    circles = {n: circle for n, circle in state.circles.items() if n > 0}
    every = [*sightings, *claimed]
    for number, match in enumerate(matches, start=1):
        points[-number] = match.xyz_mm
        every += [
            sighting_of_dot(photo, -number, left[photo][dot]) for photo, dot in match.dots.items()
        ]
    state = replace(state, points=points, circles=circles)
    stages = stages_for(len(state.photos))[-1:]
    return adjusted(state, every, bars, network.middle_px, stages), every


def _with_more_photos(
    network: Network,
    sightings: list[Sighting],
    bars: list[Bar],
    dots: Dots,
    declared: dict[str, float],
    without: dict[int, str],
) -> tuple[Network, list[Sighting]]:
    """Return the network with photographs that plain targets help to place."""
    left = {n: found for n, found in dots.items() if n not in without}
    poses, more = recovered(network, sightings, left)
    if not poses:
        return network, sightings
    state = state_of(network, declared)
    state = replace(state, photos={**state.photos, **poses})
    every = [*sightings, *more]
    stages = stages_for(len(state.photos))[-1:]
    network = adjusted(state, every, bars, network.middle_px, stages)
    # What only they and two others see can be matched now.
    base = [s for s in sightings if s.point > 0]
    return _with_dots(network, base, bars, left, declared)


def _box(network: Network) -> Array:
    points = network.solution.values["points"]
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * float((high - low).max())
    return np.array([low - margin, high + margin])


def _claimed(
    network: Network, sightings: list[Sighting], dots: Dots
) -> tuple[list[Sighting], Dots]:
    """Return coded targets whose ring was not read but whose dot was found; and the dots left.

    What lies within the ring of a known coded target is neither: sectors of its ring.
    """
    claimed: list[Sighting] = []
    left: Dots = {}
    read = {(s.photo, s.point) for s in sightings}
    radius = 0.5 * network.diameters_mm.get(CODED, 0.0)
    numbers = [n for n in network.points if n > 0]
    for photo in network.photos:
        of_photo = dots.get(photo, ())
        if not of_photo:
            continue
        rows = np.array([network.points[n] for n in numbers])
        here = np.full(len(rows), network.photos[photo])
        pixels, inside = project(network.solution.values, here, rows, network.middle_px)
        size = network.lens[0] * radius / np.maximum(inside[:, 2], 1e-9)
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
