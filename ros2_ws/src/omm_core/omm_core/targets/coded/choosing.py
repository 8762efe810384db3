"""Numbers of a family that are hard to mistake for each other.

Two codes are as far apart as

* their *distance*: how many sectors must be misread (smallest over all rotations), and
* their *arc*: how many sectors in a row a chip must cover, at least, to turn one into the other.

`propose_ids` makes the smallest distance within the set as large as it can, then the smallest arc,
and never takes a code together with its mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.targets.coded.families import TargetFamily, mirror_code

MOST_COMPARED = 1500
"""Codes of a large family that are compared with each other (evenly drawn)."""
STARTS = 24


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A set of numbers and how far apart they are.

    Attributes
    ----------
    distance : sectors that must be misread to take one for another, at least.
    arc : sectors in a row that must be covered for that, at least.
    """

    ids: tuple[int, ...]
    distance: int
    arc: int
    bits: int

    def why(self) -> str:
        """Return the reason in words."""
        degrees = 360.0 * self.arc / self.bits
        return (
            f"at least {self.distance} of {self.bits} sectors must be misread, or {self.arc} in a "
            f"row ({degrees:.0f} degrees of the ring) be covered, to take one of these for another"
        )


def separation(family: TargetFamily, ids: tuple[int, ...]) -> Proposal:
    """Tell how far the given numbers are apart."""
    codes = np.array([family.code_of(i) for i in ids], dtype=np.int64)
    distance, arc = _pairs(codes, codes, family.bits)
    other = ~np.eye(len(codes), dtype=bool)
    none = family.bits
    return Proposal(
        ids=ids,
        distance=int(distance[other].min()) if other.any() else none,
        arc=int(arc[other].min()) if other.any() else none,
        bits=family.bits,
    )


def propose_ids(family: TargetFamily, count: int) -> Proposal:
    """Propose `count` numbers that are hard to mistake for each other.

    Raises
    ------
    InputError
        If the family does not have as many codes without their mirror images.
    """
    codes = np.asarray(family.codes)
    if len(codes) > MOST_COMPARED:
        codes = codes[np.linspace(0, len(codes) - 1, MOST_COMPARED).astype(np.int64)]
    mirrors = np.array([mirror_code(int(code), family.bits) for code in codes])
    unlike = codes[mirrors >= codes]
    if not 1 <= count <= len(unlike):
        raise InputError(
            f"Expected a count from 1 to {len(unlike)} for {family.name}, got {count}: "
            "name the numbers with --ids or take a larger family."
        )
    distance, arc = _pairs(unlike, unlike, family.bits)
    score = distance * (family.bits + 1) + arc
    best: tuple[int, list[int]] = (-1, [])
    for start in np.linspace(0, len(unlike) - 1, STARTS).astype(np.int64):
        chosen = _farthest_first(score, int(start), count)
        block = score[np.ix_(chosen, chosen)] + np.eye(count, dtype=np.int64) * 10**6
        if int(block.min()) > best[0]:
            best = (int(block.min()), chosen)
    ids = sorted(family.id_of(int(unlike[i])) or 0 for i in best[1])
    return separation(family, tuple(ids))


def _farthest_first(score: NDArray[np.int64], start: int, count: int) -> list[int]:
    """Begin with `start`; add what is farthest from all that is chosen."""
    chosen = [start]
    nearest = score[start].copy()
    nearest[start] = -1
    while len(chosen) < count:
        following = int(np.argmax(nearest))
        chosen.append(following)
        nearest = np.minimum(nearest, score[following])
        nearest[chosen] = -1
    return chosen


def _pairs(
    a: NDArray[np.int64], b: NDArray[np.int64], bits: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the distances and arcs of all pairs, shapes (len(a), len(b))."""
    weights, arcs = _tables(bits)
    mask = (1 << bits) - 1
    distance = np.full((len(a), len(b)), bits, dtype=np.int64)
    arc = distance.copy()
    for steps in range(bits):
        turned = ((b << steps) | (b >> (bits - steps))) & mask
        differ = a[:, None] ^ turned[None, :]
        distance = np.minimum(distance, weights[differ])
        arc = np.minimum(arc, arcs[differ])
    return distance, arc


def _tables(bits: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return, for every value, the number of set bits and the shortest arc with all of them."""
    values = np.arange(1 << bits, dtype=np.int64)
    weights = np.zeros_like(values)
    clear = np.zeros_like(values)
    run = np.zeros_like(values)
    for turn in range(2 * bits):
        bit = (values >> (turn % bits)) & 1
        if turn < bits:
            weights += bit
        run = np.where(bit == 1, 0, run + 1)
        clear = np.maximum(clear, np.minimum(run, bits))
    return weights, bits - clear
