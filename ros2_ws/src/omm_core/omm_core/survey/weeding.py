"""What does not belong: targets that moved, photographs with another zoom, what contradicts itself.

Rays are tested one by one in `network`; here it is judged what the rejected ones have in common, so
that the cause can be named and all that it touched be left out.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.survey.camera_model import undistorted
from omm_core.survey.misreading import misread_targets
from omm_core.survey.moved_dots import moved_dots, name_of_dot, words_of_move
from omm_core.survey.network import (
    BAD_SHARE,
    CONTRADICTS,
    FEWEST_IN_PHOTO,
    FEWEST_RAYS,
    REJECTION,
    Network,
)
from omm_core.survey.undecided import undecided_points

Array = NDArray[np.float64]

_MOVED_SIGMAS = 5.0
_FAR_SIGMAS, _FAR_PX = 12.0, 0.25
_TWO_SHARE = 0.25  # of a point's rays: so many at least, where only two agree
_MOST = 0.6  # of the rejected rays
_AGREES_PX = 0.05
ONE_OF_TWO = "it is the same dot as another"


@dataclass(frozen=True, kw_only=True)
class Misfits:
    """What is left out, and why, in words that follow its name."""

    points: dict[int, str] = field(default_factory=dict)
    photos: dict[int, str] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.points or self.photos)

    def with_(self, more: Misfits) -> Misfits:
        """Return both; the first reason stays."""
        return Misfits(points={**more.points, **self.points}, photos={**more.photos, **self.photos})


def misfits_of(network: Network) -> Misfits:
    """Return what must be left out of a network with all of its rays."""
    points = {**undecided_points(network), **_contradicting_points(network), **_moved(network)}
    for pair in moved_dots(network):
        points |= dict.fromkeys(pair, ONE_OF_TWO) | {pair[0]: words_of_move(network, pair)}
    return Misfits(points=points, photos=_contradicting_photos(network, set(points)))


def words_of_dots(network: Network, misfits: Misfits) -> list[str]:
    """Return what must be told of plain dots that are left out; they have no numbers."""
    return [
        f"{name_of_dot(network.xyz_mm(n), network)} is left out: {why}."
        for n, why in misfits.points.items()
        if n < 0 and why not in (CONTRADICTS, ONE_OF_TWO)
    ]


def _contradicting_points(network: Network) -> dict[int, str]:
    """Return points of which no ray can be spared, though one does not fit."""
    bad = network.used & (network.t2 > REJECTION)
    rays = network.ray_counts()
    numbers = {s.point for s, out in zip(network.sightings, bad, strict=True) if out}
    return {n: CONTRADICTS for n in sorted(numbers) if rays[n] <= FEWEST_RAYS}


def _contradicting_photos(network: Network, without: set[int]) -> dict[int, str]:
    every, used, bad = Counter[int](), Counter[int](), Counter[int]()
    for s, u, t2 in zip(network.sightings, network.used, network.t2, strict=True):
        if s.point not in without:
            every[s.photo] += 1
            used[s.photo] += int(u)
            bad[s.photo] += int(u and t2 > REJECTION)
    reasons = {}
    for photo, count in every.items():
        out = count - used[photo]
        few = bad[photo] and used[photo] <= FEWEST_IN_PHOTO
        if few or (out >= 3 and out > BAD_SHARE * count):
            reasons[photo] = f"{out + bad[photo]} of its {count} rays contradict the others"
    return reasons


def _moved(network: Network) -> dict[int, str]:
    """Return targets whose rejected rays agree on another place."""
    out: dict[int, list[int]] = {}
    away = np.linalg.norm(network.solution.residuals["rays"], axis=1)
    detector = np.array([s.covariance_px2 for s in network.sightings])
    covariance = network.noise.covariance(detector, network.kinds)
    sigma = np.sqrt(np.einsum("mii->m", covariance) / 2.0)
    # Two rays that are off by a little always meet somewhere near.
    far = ~network.used & (away > np.maximum(_FAR_SIGMAS * sigma, _FAR_PX))
    misread = {(m.photo, m.read) for m in misread_targets(network)}
    for i in np.flatnonzero(far):
        if (network.sightings[i].photo, network.sightings[i].point) in misread:
            continue
        out.setdefault(network.sightings[i].point, []).append(int(i))
    moved = {}
    for point, rays in out.items():
        if len(rays) < 2:
            continue
        meeting = _meeting(network, rays)
        # Two rays that are off for reasons of their own now and then meet by chance.
        if meeting is not None and (meeting[1] > 2 or _TWO_SHARE * network.rays_of(point) <= 2):
            place, count = meeting
            by = float(np.linalg.norm(place - network.xyz_mm(point)))
            moved[point] = (
                f"{count} photographs show it {by:.2f} mm from where the other"
                f" {network.rays_of(point)} do: it moved"
                + (", or its number stands on two targets" if point > 0 else "")
            )
    return moved


def _meeting(network: Network, rays: list[int]) -> tuple[Array, int] | None:
    """Return where most of the rays meet and how many, or None where they do not."""
    left = list(rays)
    while len(left) >= max(2, _MOST * len(rays)):
        found = _intersection(network, left)
        if found is None:
            return None
        place, misfits = found
        if misfits.max() < 1.0:
            return place, len(left)
        del left[int(np.argmax(misfits))]
    return None


def _intersection(network: Network, rays: list[int]) -> tuple[Array, Array] | None:
    """Return where rays come closest, and their misfits there: below 1 they fit."""
    seen = np.array([network.sightings[i].center_px for i in rays])
    poses = np.array([network.pose(network.sightings[i].photo) for i in rays])
    lenses = np.array([network.lens_of(network.sightings[i].photo) for i in rays])
    ideal = undistorted(lenses, seen - network.middle_px)
    turns = Rotation.from_rotvec(poses[:, :3])
    looks = turns.inv().apply(np.column_stack([ideal, np.ones(len(ideal))]))
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)
    across = np.eye(3) - looks[:, :, None] * looks[:, None, :]
    normal = across.sum(axis=0)
    if np.linalg.eigvalsh(normal)[0] < 1e-4 * len(rays):
        return None
    place = np.linalg.solve(normal, np.einsum("nij,nj->i", across, poses[:, 3:]))
    inside = turns.apply(place - poses[:, 3:])
    if (inside[:, 2] <= 0).any():
        return None
    off = (inside[:, :2] / inside[:, 2:] - ideal) * lenses[:, :1]
    detector = np.array([network.sightings[i].covariance_px2 for i in rays])
    covariance = network.noise.covariance(detector, network.kinds[rays])
    t2 = np.einsum("mi,mij,mj->m", off, np.linalg.inv(covariance), off)
    # Perspective is not taken off here: a few hundredths of a pixel are no contradiction.
    return place, np.minimum(t2 / _MOVED_SIGMAS**2, np.linalg.norm(off, axis=1) / _AGREES_PX)
