"""Numbers that were read wrong: a target lies where another one must be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from omm_core.survey.camera_model import project
from omm_core.survey.network import Network

_NEAR_PX = 2.0  # of where the other must be


@dataclass(frozen=True, kw_only=True)
class Misreading:
    """In a photograph, what was read as one target is another."""

    photo: int
    read: int
    is_target: int


def misread_targets(network: Network) -> list[Misreading]:
    """Return the rays left out that lie where another coded target must be seen."""
    numbers = np.array([n for n in network.points if n > 0])
    rows = np.array([network.points[int(n)] for n in numbers], dtype=int)
    found = []
    for i in np.flatnonzero(~network.used):
        s = network.sightings[i]
        if s.point < 0:
            continue
        here = np.full(len(rows), network.photos[s.photo])
        values = {**network.solution.values, "lens": network.lens_of(s.photo)[None]}
        pixels, inside = project(values, here, rows, network.middle_px)
        apart = np.linalg.norm(pixels - s.center_px, axis=1)
        apart[(inside[:, 2] <= 0) | (numbers == s.point)] = np.inf
        nearest = int(np.argmin(apart))
        if apart[nearest] < _NEAR_PX:
            found.append(Misreading(photo=s.photo, read=s.point, is_target=int(numbers[nearest])))
    return found


def misreading_words(misreadings: list[Misreading], photo_names: dict[int, str]) -> list[str]:
    """Return a sentence for each, one for both of a swapped pair."""
    every = {(m.photo, m.read, m.is_target) for m in misreadings}
    words = []
    for photo, read, really in sorted(every):
        name = photo_names[photo]
        if (photo, really, read) not in every:
            words.append(f"{name}: what was read as target {read} is target {really}; left out.")
        elif read < really:
            words.append(
                f"{name}: the numbers of targets {read} and {really} are swapped; both are left"
                " out there."
            )
    return words
