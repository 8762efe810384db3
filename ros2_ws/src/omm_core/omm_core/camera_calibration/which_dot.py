"""Which of several bright things is the dot: the ones on which one camera agrees.

Radial alignment (start.py) needs neither focal length nor distortion: seven dots give the direction
in which each other one lies from the middle of the image, and its offset there in mm. As many
times as the dot's image is larger or smaller than the dot, so is its distance from the middle::

    (x, y) = (r1 · X + tx, r2 · X + ty) · diameter in px / diameter in mm

Sevens are drawn at random, one thing from each image; the seven with which most images have
something to agree decides (RANSAC: Fischler and Bolles 1981). A ghost of the lens, opposite to
the dot, and a reflection that moves along are not where their size would have them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.camera_calibration.model import Sensor

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SEVEN = 7
_FEWEST_IMAGES = 12
_DRAWS, _AT_A_TIME = 12000, 1000
_REFINED = 5
# How far from where it must be a dot may lie: principal points are off by that (image widths), and
# distortion and oblique views change sizes by that (of its distance from the middle).
_BESIDE, _OBLIQUE = 0.02, 0.2


@dataclass(frozen=True, kw_only=True, eq=False)
class _Things:
    """What is bright in all images, M things.

    ``xy`` (M, 2) is from the middle of the image, and ``scale`` (M,) what a length of ``known``
    (M, 4: place, 1) is in the image, both in image widths; ``image_of`` (M,) is ascending.
    """

    xy: Array
    scale: Array
    known: Array
    image_of: Indices

    def rows(self) -> Array:
        """Return the equations y (r1 · X + tx) - x (r2 · X + ty) = 0, (M, 8)."""
        return np.column_stack([self.xy[:, 1:] * self.known, -self.xy[:, :1] * self.known])


def agreeing_things(
    sensor: Sensor,
    places: Array,
    centres: Sequence[Array],
    diameters_px: Sequence[Array],
    dot_diameter_mm: float,
) -> list[int | None]:
    """Return which thing of each image is likely the dot; None where none agrees.

    Parameters
    ----------
    sensor : Sensor
    places : (N, 3) array
        Where the dot was, taper frame, mm.
    centres, diameters_px : sequences of N arrays (K, 2), (K,)
        Of what is bright in each image, (col, row) px; K may differ.
    dot_diameter_mm : float
    """
    found: list[int | None] = [None] * len(centres)
    image_of = np.concatenate([np.full(len(t), i, dtype=int) for i, t in enumerate(centres)])
    if len(np.unique(image_of)) < _FEWEST_IMAGES:
        return found
    middle = [(sensor.width_px - 1) / 2, (sensor.height_px - 1) / 2]
    spread = float(np.ptp(places, axis=0).max()) or 1.0
    known = np.column_stack([(places - places.mean(axis=0)) / spread, np.ones(len(places))])
    per_mm = np.concatenate(list(diameters_px)) / dot_diameter_mm
    things = _Things(
        xy=(np.concatenate(list(centres)) - middle) / sensor.width_px,
        scale=per_mm * spread / sensor.width_px,
        known=known[image_of],
        image_of=image_of,
    )
    first = {int(i): int(np.searchsorted(image_of, i)) for i in np.unique(image_of)}
    for at in _agreeing(things):
        image = int(image_of[at])
        found[image] = int(at) - first[image]
    return found


def _agreeing(things: _Things) -> Indices:
    """Return the things that agree, at most one of each image."""
    rows = things.rows()
    best = _best_of_draws(things)
    chosen = _chosen(_away(best[None], things)[0], things.image_of)
    for _ in range(_REFINED):
        if len(chosen) < _SEVEN:
            break
        refined = np.linalg.svd(rows[chosen])[2][-1]
        again = _chosen(_away(refined[None], things)[0], things.image_of)
        if len(again) < len(chosen):
            break
        chosen = again
    return chosen


def _best_of_draws(things: _Things) -> Array:
    """Return the solution (8,) of the seven things with which most images agree."""
    rng = np.random.default_rng(7)
    rows, image_of = things.rows(), things.image_of
    many = np.bincount(image_of)[image_of].astype(float)
    best, most = np.zeros(8), -1.0
    for _ in range(_DRAWS // _AT_A_TIME):
        # The first of exponential races are a draw without replacement, by weight: what is alone
        # in its image is more likely the dot.
        race = rng.exponential(size=(_AT_A_TIME, len(rows))) * many**2
        sevens = np.argpartition(race, _SEVEN, axis=1)[:, :_SEVEN]
        solutions = np.linalg.svd(rows[sevens])[2][:, -1]
        score = _score(_away(solutions, things), image_of)
        at = int(np.argmax(score))
        if score[at] > most:
            best, most = solutions[at], float(score[at])
    return best


def _away(solutions: Array, things: _Things) -> Array:
    """Return how far each thing is from where it must be, (B, M), in what is allowed.

    Solutions (B, 8) are known up to size and sign; of the signs that with which more agree counts.
    """
    size = np.linalg.norm(solutions[:, :3], axis=1) + np.linalg.norm(solutions[:, 4:7], axis=1)
    unit = 2.0 * solutions / (size[:, None] + 1e-300)
    x = unit[:, :4] @ things.known.T * things.scale
    y = unit[:, 4:] @ things.known.T * things.scale
    allowed = _BESIDE + _OBLIQUE * np.linalg.norm(things.xy, axis=1)

    def away(sign: float) -> Array:
        dx, dy = things.xy[:, 0] - sign * x, things.xy[:, 1] - sign * y
        length = np.hypot(x, y) + 1e-300
        beside = np.abs(dx * y - dy * x) / length / _BESIDE
        return np.asarray(np.maximum(np.hypot(dx, dy) / allowed, beside))

    plus, minus = away(1.0), away(-1.0)
    more = (plus < 1.0).sum(axis=1) >= (minus < 1.0).sum(axis=1)
    return np.where(more[:, None], plus, minus)


def _score(away: Array, image_of: Indices) -> Array:
    """Return how well images agree with each solution, (B,): the best thing of each counts."""
    credit = np.maximum(1.0 - away**2, 0.0)
    starts = np.flatnonzero(np.r_[True, np.diff(image_of) > 0])
    return np.asarray(np.maximum.reduceat(credit, starts, axis=1).sum(axis=1))


def _chosen(away: Array, image_of: Indices) -> Indices:
    """Return the thing of each image that is nearest to where it must be, where near enough."""
    order = np.lexsort((away, image_of))
    least = order[np.flatnonzero(np.r_[True, np.diff(image_of[order]) > 0])]
    return np.asarray(least[away[least] < 1.0])
