"""Stops that take the least machine time and still reach what is wished.

The fewest images are not the quickest: what the wish leaves of U is spent on stops that lie nearer
to each other, in the order in which they are gone to. A set changes only where that shortens the
way, keeps each target seen as often as it was, and keeps the wish; and no stop is exchanged for one
that loses its targets sooner where the part lies elsewhere (up to ``_MARGIN_MM``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.planning.candidates import Candidates
from omm_core.planning.choosing import TWICE, Pool, add_best, allowed_instead
from omm_core.planning.scene import Scene
from omm_core.planning.timing import Pace
from omm_core.planning.tour import shortest_tour

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_PASSES = 12
_MOST_TRIED = 256  # of the quickest places for one stop
_BATCH = 32
_WORTH_S = 1e-3
_MARGIN_MM = 30.0
_STARTS = 2  # the fewest images, and one more


@dataclass(frozen=True, kw_only=True, eq=False)
class _Way:
    """Times between candidates as straight moves; ``axes`` (C, A) in the order of the pace."""

    pace: Pace
    axes: Array

    def to(self, here: int, there: Indices) -> Array:
        """Return seconds from one candidate to others."""
        return self.pace.moves_s(self.axes[here], self.axes[there])

    def length(self, order: Indices) -> float:
        """Return seconds along an order, stops included."""
        moves = self.pace.moves_s(self.axes[order[:-1]], self.axes[order[1:]])
        return float(np.sum(moves)) + self.pace.stop_s * len(order)


def quickest(
    scene: Scene, pace: Pace, candidates: Candidates, pool: Pool, chosen: Indices
) -> Indices:
    """Return stops, in their order, that take the least time that was found.

    ``chosen`` as it is where it does not reach the wish: then nothing is to be given away.
    """
    if pool.shortfall(chosen) > 1.0:
        return chosen
    way = _Way(
        pace=pace, axes=np.array([[axes[n] for n in pace.limits] for axes in candidates.axes])
    )
    found, start = [], chosen
    for _ in range(_STARTS):
        found.append(_shortened(scene, way, candidates, pool, start))
        start = add_best(pool, start)
    return min([*found, chosen], key=lambda s: _exact_s(scene, pace, candidates, s))


def _exact_s(scene: Scene, pace: Pace, candidates: Candidates, chosen: Indices) -> float:
    """Return the seconds of the tour as it will be gone, around the part where needed."""
    tour = shortest_tour(scene, pace, [candidates.axes[i] for i in chosen])
    return tour.seconds if tour.free else tour.seconds + 1e6


def _shortened(
    scene: Scene, way: _Way, candidates: Candidates, pool: Pool, chosen: Indices
) -> Indices:
    order = chosen
    for _ in range(_PASSES):
        tour = shortest_tour(scene, way.pace, [candidates.axes[i] for i in order])
        order = order[list(tour.order)]
        before = way.length(order)
        order = _without_spare(pool, order)
        for position in range(len(order)):
            order = _nearer(way, pool, order, position)
        if way.length(order) > before - _WORTH_S:
            break
    return order


def _without_spare(pool: Pool, order: Indices) -> Indices:
    """Return the order without stops that neither the wish nor "each target twice" needs."""
    for stop in order.tolist():
        fewer = order[order != stop]
        times = pool.visible[order].sum(axis=0)
        kept = np.all(pool.visible[fewer].sum(axis=0) >= np.minimum(TWICE, times))
        if len(fewer) and kept and pool.shortfall(fewer) <= 1.0:
            order = fewer
    return order


def _nearer(way: _Way, pool: Pool, order: Indices, position: int) -> Indices:
    """Return the order with one stop where the way is shortest and the wish still reached."""
    allowed = allowed_instead(pool, np.delete(order, position), int(order[position]), most=None)
    margin = np.minimum(pool.margin_mm, _MARGIN_MM)
    allowed = allowed[margin[allowed] >= margin[order[position]]]
    beside = [order[p] for p in (position - 1, position + 1) if 0 <= p < len(order)]
    added = np.sum([way.to(int(b), allowed) for b in beside], axis=0)
    present = float(added[allowed == order[position]][0])
    better = np.flatnonzero(added < present - _WORTH_S)
    better = better[np.argsort(added[better], kind="stable")][:_MOST_TRIED]
    for first in range(0, len(better), _BATCH):
        some = better[first : first + _BATCH]
        sets = np.repeat(order[None], len(some), axis=0)
        sets[:, position] = allowed[some]
        for row in np.flatnonzero(pool.reached_by_U(sets)):
            if pool.shortfall(sets[row]) <= 1.0:
                return np.asarray(sets[row])
    return order
