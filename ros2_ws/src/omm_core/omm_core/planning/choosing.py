"""Chooses stops on the full covariance: first so that all is seen twice, then exchanged, then more.

The information of stops is not additive (the machine's geometry and the targets are common to
them), so that each exchange is judged by the covariance of the whole set.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.planning.prediction import Designs, determines, own_covariances
from omm_core.planning.scene import AssumedNoise
from omm_core.planning.wish import Yardstick, smallest_bumps_mm

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_MARGIN_ENOUGH_MM = 50.0
TWICE = 2
"""How often each target is seen at least."""
_PASSES = 6
_GAIN = 0.002  # smaller gains of an exchange are not worth another pass
_BATCH_ELEMENTS = 3_000_000
_WORK = 2_000_000  # elements of all matrices of an exchange's stops


@dataclass(frozen=True, kw_only=True, eq=False)
class Pool:
    """What can be chosen from, and what it is judged by.

    Attributes
    ----------
    visible : (C, T) array of bool
    margin_mm : (C,) array
        How much farther the part may lie elsewhere before a stop loses a target.
    """

    designs: Designs
    visible: NDArray[np.bool_]
    margin_mm: Array
    noise: AssumedNoise
    yardstick: Yardstick

    def covariances(self, sets: Indices) -> Array:
        """Return the covariances of sets (B, S) in own coordinates, (B, 7, 7)."""
        rows = sets.shape[1] * self.designs.A.shape[1]
        size = max(1, _BATCH_ELEMENTS // max(rows * rows, rows * 3 * sets.shape[1]))
        return np.concatenate(
            [
                own_covariances(self.designs, self.noise, sets[first : first + size])
                for first in range(0, len(sets), size)
            ]
        )

    def scores(self, sets: Indices) -> Array:
        """Return how far sets are from the wish, (B,); lower is better."""
        covariances = self.covariances(sets)
        worst = self.yardstick.score(covariances)
        # The worst alone stands still while another is bettered; a share of all leads on.
        overall = np.sqrt(np.mean(self.yardstick.corner_U_mm(covariances) ** 2, axis=-1))
        return np.asarray(worst + 0.02 * worst.min(initial=np.inf) * overall / overall.min())

    def score(self, chosen: Indices) -> float:
        """Return how many times too large U is."""
        return float(self.yardstick.score(self.covariances(chosen[None]))[0])

    def reached_by_U(self, sets: Indices) -> NDArray[np.bool_]:
        """Return which sets (B, S) reach the wanted U; all where none is wanted."""
        if not self.yardstick.wish.of_pose:
            return np.ones(len(sets), dtype=bool)
        return np.asarray(self.yardstick.score(self.covariances(sets)) <= 1.0)

    def shortfall(self, chosen: Indices) -> float:
        """Return how many times too large U or the smallest bump is; at most 1 is reached."""
        wish = self.yardstick.wish
        if not determines(self.designs, chosen):
            return np.inf
        missed = self.score(chosen) if wish.of_pose else 0.0
        if wish.bump_mm is not None:
            bumps = smallest_bumps_mm(self.designs, self.noise, chosen)
            missed = max(missed, max(bumps.values(), default=np.inf) / wish.bump_mm)
        return missed


def cover_twice(pool: Pool) -> Indices:
    """Return few stops that see every target that can be seen twice."""
    seeable = pool.visible.any(axis=0)
    missing = np.where(seeable, TWICE, 0)
    chosen: list[int] = []
    while np.any(missing > 0):
        gain = pool.visible.astype(int) @ (missing > 0).astype(int)
        gain = np.where(np.isin(np.arange(len(gain)), chosen), 0, gain)
        if gain.max(initial=0) == 0:
            break  # only one stop sees it
        most = np.flatnonzero(gain == gain.max())
        chosen.append(int(_widest(pool, chosen, most)))
        missing = missing - pool.visible[chosen[-1]]
    return np.array(chosen, dtype=np.int64)


def _widest(pool: Pool, chosen: list[int], among: Indices) -> int:
    """Return the stop that lies farthest from those that see the same targets."""
    places = pool.designs.place_mm
    same = [c for c in chosen if np.any(pool.visible[c] & pool.visible[among].any(axis=0))]
    if not same:
        middle = places[among].mean(axis=0)
        return int(among[np.argmax(np.linalg.norm(places[among] - middle, axis=1))])
    distance = np.linalg.norm(places[among][:, None] - places[same], axis=2).min(axis=1)
    return int(among[np.argmax(distance)])


def exchange(pool: Pool, chosen: Indices, passes: int = _PASSES) -> Indices:
    """Return the set after each stop was exchanged for the best, as long as that helps."""
    best = pool.score(chosen)
    for _ in range(passes):
        before = best
        for position in range(len(chosen)):
            others = np.delete(chosen, position)
            allowed = allowed_instead(pool, others, chosen[position])
            sets = np.repeat(chosen[None], len(allowed), axis=0)
            sets[:, position] = allowed
            scores = pool.scores(sets)
            winner = int(np.argmin(scores))
            chosen = sets[winner].copy()
        best = pool.score(chosen)
        if not best < before * (1.0 - _GAIN):
            break
    return chosen


def settle(pool: Pool, chosen: Indices, limit: float) -> Indices:
    """Return the set after stops were exchanged for such as lose no target so soon.

    As long as the score stays within a limit: U at the border of the image is bought dearly where
    the part then lies elsewhere.
    """
    margin = np.minimum(pool.margin_mm, _MARGIN_ENOUGH_MM)
    for position in [*range(len(chosen))] * 2:
        allowed = allowed_instead(pool, np.delete(chosen, position), chosen[position])
        allowed = allowed[margin[allowed] >= margin[chosen[position]]]
        sets = np.repeat(chosen[None], len(allowed), axis=0)
        sets[:, position] = allowed
        scores = pool.yardstick.score(pool.covariances(sets))
        good = np.flatnonzero(scores <= limit)
        if len(good):
            best = good[np.lexsort((scores[good], -np.round(margin[allowed[good]], 1)))[0]]
            chosen = sets[best].copy()
    return chosen


def allowed_instead(pool: Pool, others: Indices, present: int, most: int | None = _WORK) -> Indices:
    """Return stops that, in place of one, leave every target seen as often as is needed.

    Of the same targets only: what sees quite other targets is seldom a gain, and 10 times as much.
    ``most`` limits how many elements their matrices have; None does not.
    """
    needed = np.minimum(TWICE, pool.visible[[*others, present]].sum(axis=0))
    left = pool.visible[others].sum(axis=0) if len(others) else np.zeros_like(needed)
    fits = np.all(left + pool.visible >= needed, axis=1)
    alike = (pool.visible & pool.visible[present]).any(axis=1)
    free = ~np.isin(np.arange(len(fits)), others)
    fits &= alike & free
    fits[present] = True
    allowed = np.flatnonzero(fits)
    if most is None:
        return allowed
    most = int(max(40, most / (len(others) + 1) ** 2 / pool.designs.A.shape[1] ** 2))
    if len(allowed) > most:  # every so many of them: neighbours are much alike
        spread = allowed[np.linspace(0, len(allowed) - 1, most).astype(int)]
        allowed = np.union1d(spread, [present])
    return allowed


def add_best(pool: Pool, chosen: Indices) -> Indices:
    """Return the set with one stop more: the one that gains most."""
    others = np.setdiff1d(np.arange(len(pool.visible)), chosen)
    if not len(others):
        return chosen
    most = int(max(100, 3 * _WORK / (len(chosen) + 1) ** 2 / pool.designs.A.shape[1] ** 2))
    others = others[np.linspace(0, len(others) - 1, min(most, len(others))).astype(int)]
    sets = np.column_stack([np.repeat(chosen[None], len(others), axis=0), others])
    return np.asarray(sets[int(np.argmin(pool.scores(sets)))])
