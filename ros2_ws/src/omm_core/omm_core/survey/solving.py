"""A survey from what was seen in its photographs: start, network, plain targets, all together."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import MeasurementError
from omm_core.survey.bars import agreeing_bars
from omm_core.survey.cameras import Cameras, pixel_of
from omm_core.survey.coded_network import LOOSE, rays_by_photo, started
from omm_core.survey.fitting import adjusted
from omm_core.survey.joining import Found, lost, with_dots, with_lost, with_more_photos
from omm_core.survey.moved_dots import words_of_lost
from omm_core.survey.network import (
    FEWEST_RAYS,
    REJECTION,
    Network,
    stages_for,
    state_of,
)
from omm_core.survey.noise import RayNoise
from omm_core.survey.sighting import Bar, Sighting
from omm_core.survey.start import (
    FITS_AT_FIRST_PX,
    resect_photos,
)
from omm_core.survey.weeding import Misfits, misfits_of, words_of_dots
from omm_core.survey.zooming import zoomed_photos
from omm_core.targets.plain import PlainDot

Array = NDArray[np.float64]

_WEEDINGS = 8
_BENT_SIGMA0 = 10.0  # times what was expected; good photographs of a real plate have 2.4
_HOPELESS_PX = 1.0  # rms; dots are found to a few hundredths
_SUSPECTS = 3  # targets tried, where one may bend everything
BENDS = "its photographs show it in places far apart; it moved, or its number stands on two targets"
_FEWEST_ZOOMS = 6  # photographs whose focal lengths can be compared


def solve_network(
    sightings: list[Sighting],
    bars: list[Bar],
    cameras: Cameras | float,
    size_px: tuple[int, int],
    dots: dict[int, tuple[PlainDot, ...]] | None = None,
    diameters_mm: dict[str, float] | None = None,
) -> Network:
    """Adjust from nothing but the nominal focal length.

    Parameters
    ----------
    sightings : list of Sighting
        The coded targets that were read; pixels are those of a picture of ``size_px``.
    cameras : Cameras or float
        With their nominal focal lengths; a number is that of the only one.
    dots : mapping, optional
        Plain dots by photograph.
    diameters_mm : mapping, optional
        Of the dots, by kind; measured where not given.

    Raises
    ------
    MeasurementError
        Where photographs are not connected or do not fit together, or no bar was measured.
    """
    middle = (np.array(size_px) - 1.0) / 2.0
    declared = diameters_mm or {}
    if not isinstance(cameras, Cameras):
        cameras = Cameras(focal_px=(float(cameras),))
    with np.errstate(all="ignore"):  # what diverges is judged by where it ends
        network = _solved_or_without_one(sightings, bars, cameras, middle, dots or {}, declared)
    if network.sigma0 > _BENT_SIGMA0 and network.rms_px > _HOPELESS_PX:
        raise MeasurementError(
            f"The photographs do not fit together: the rays are {network.rms_px:.1f} px off (rms),"
            f" {network.sigma0:.0f} times what was expected, and nothing that was found is to blame"
            " alone. Expected one part with its targets and scale bars at rest, one lens untouched"
            " (fixed focus and zoom, no stabiliser), and every number once."
        )
    return _with_unplaced(network, sightings)


def _with_unplaced(network: Network, sightings: list[Sighting]) -> Network:
    """Return the network with a reason for every target that was read and has no place in it."""
    rays = Counter(s.point for s in sightings if s.photo in network.photos)
    gone = {
        n: f"its {count} rays do not meet in one place, and do not tell which are wrong"
        for n, count in sorted(rays.items())
        if count >= FEWEST_RAYS and n not in network.points and n not in network.left_out_points
    }
    few = tuple(n for n, count in sorted(rays.items()) if count < FEWEST_RAYS)
    return replace(
        network,
        left_out_points={**network.left_out_points, **gone},
        few_rays=tuple(n for n in few if n not in network.points),
    )


def _solved_or_without_one(
    sightings: list[Sighting],
    bars: list[Bar],
    cameras: Cameras,
    middle: Array,
    dots: dict[int, tuple[PlainDot, ...]],
    declared: dict[str, float],
) -> Network:
    """Return the network; without one target where nothing fits with it."""
    given = (bars, cameras, middle, dots, declared)
    try:
        network = _solved(sightings, *given)
    except MeasurementError as error:
        found = _solved_without_one(sightings, *given) if str(error) == LOOSE else None
        if found is None:
            raise
        return found
    if network.sigma0 > _BENT_SIGMA0:
        return _solved_without_one(sightings, *given) or network
    return network


def _solved_without_one(
    sightings: list[Sighting],
    bars: list[Bar],
    cameras: Cameras,
    middle: Array,
    dots: dict[int, tuple[PlainDot, ...]],
    declared: dict[str, float],
) -> Network | None:
    """Return the network without the one target that bends all others, or None.

    A target that half of its photographs show somewhere else, far away, spoils the start: its error
    passes for noise, and later everything contradicts everything.
    """
    try:
        bent = started(sightings, bars, cameras, middle, declared)
    except MeasurementError:
        return None
    far = dict.fromkeys({s.point for s in sightings}, np.inf)  # what has no place comes first
    far.update(dict.fromkeys(bent.points, 0.0))
    off = np.linalg.norm(bent.solution.residuals["rays"], axis=1)
    for sighting, away in zip(bent.sightings, off, strict=True):
        far[sighting.point] += float(away)
    for number in sorted(far, key=lambda n: (-far[n], n))[:_SUSPECTS]:
        left = [s for s in sightings if s.point != number]
        try:
            network = _solved(left, bars, cameras, middle, dots, declared)
        except MeasurementError:
            continue
        if network.sigma0 < _BENT_SIGMA0:
            return replace(network, left_out_points={number: BENDS, **network.left_out_points})
    return None


def _solved(
    sightings: list[Sighting],
    bars: list[Bar],
    cameras: Cameras,
    middle: Array,
    dots: dict[int, tuple[PlainDot, ...]],
    declared: dict[str, float],
) -> Network:
    network = started(sightings, bars, cameras, middle, declared)
    zoomed = _zoomed(network, sightings, declared)
    if zoomed:
        sightings = [s for s in sightings if s.photo not in zoomed]
        found_px = tuple(float(f) for f in network.solution.values["lens"][:, 0])
        known = replace(cameras, focal_px=found_px)
        network = started(sightings, bars, known, middle, declared)
    # A bar's end that moved must not make the bars disagree. Others are judged in the end, when
    # plain targets hold photographs that show few coded ones.
    ends = {end for bar in bars for end in bar.ends}
    moved = {n: why for n, why in misfits_of(network).points.items() if n in ends}
    sightings = [s for s in sightings if s.point not in moved]
    try:
        if moved:
            network = _without(network, moved, sightings, declared)
        bars, words = agreeing_bars(network, bars)
        out = Misfits(points=moved, photos=zoomed)
        left = {n: of_photo for n, of_photo in dots.items() if n not in zoomed}
        found = Found(sightings=sightings, bars=bars, dots=left, declared_mm=declared)
        every = sightings
        if dots:
            network, every = with_more_photos(*with_dots(network, found), found)
        network = _weeded(network, every, bars, declared, out)
        if lost(network, found):
            # Judged before plain targets held them, or beside what is left out now.
            network, every = with_lost(network, found)
            network = _weeded(network, every, bars, declared, out)
    except np.linalg.LinAlgError:
        raise MeasurementError(LOOSE) from None
    return replace(network, words=(*words, *network.words))


def _zoomed(
    network: Network, sightings: list[Sighting], declared: dict[str, float]
) -> dict[int, str]:
    """Return photographs with another focal length than most, and why that is thought."""
    state = replace(state_of(network, declared), noise=RayNoise())
    rays, pixel = rays_by_photo(sightings, state, network.middle_px), pixel_of(state.lenses)
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
    state, words = state_of(network, declared), list(network.words)
    for _ in range(_WEEDINGS):
        stages = stages_for(len(state.photos))[-1:]
        network = adjusted(state, sightings, bars, network.middle_px, stages, REJECTION)
        out = out.with_(Misfits(points=network.left_out_points, photos=network.left_out_photos))
        words += words_of_lost(network.left_out_points, state, sightings, network)
        more = misfits_of(network)
        if not more:
            break
        out = out.with_(more)
        words += words_of_dots(network, more)
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
    if not network.bars:
        raise MeasurementError(_without_scale(bars, out))
    words = list(dict.fromkeys(words))
    return replace(network, left_out_points=told, left_out_photos=out.photos, words=tuple(words))


def _without_scale(bars: list[Bar], out: Misfits) -> str:
    """Return what is told where the ends of all bars were left out."""
    ends = {end: out.points[end] for bar in bars for end in bar.ends if end in out.points}
    gone = [f"target {end}, a bar's end, is left out: {why}" for end, why in ends.items()]
    why = "; ".join(gone) or "too few photographs are left that show the scale bars' ends"
    return f"The coordinates have no scale: {why}. Photograph the bars more often."
