"""Families of ring-coded targets: which codes exist, their numbers and the ring's proportions.

A target is a dot of radius r and a concentric ring of n equal sectors, each set (like the dot)
or clear (like the background). Bits are read clockwise as the viewer sees the target, most
significant first; the *code* is the smallest value over all cyclic rotations, the *number* is the
code's rank in ascending order, from 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError

Maker = Literal["aicon", "metashape"]

BITS = (12, 14, 16, 20)
"""Numbers of sectors that both makers print."""

# Ring radii in units of the dot's radius: (inner, outer).
_RING: dict[str, tuple[float, float]] = {"aicon": (2.0, 3.0), "metashape": (2.25, 3.5)}


def rotate_code(code: int, steps: int, bits: int) -> int:
    """Rotate a code cyclically by `steps` sectors towards the most significant bit."""
    steps %= bits
    mask = (1 << bits) - 1
    return ((code << steps) | (code >> (bits - steps))) & mask


def smallest_rotation(code: int, bits: int) -> int:
    """Return the smallest value over all cyclic rotations of a code."""
    return min(rotate_code(code, steps, bits) for steps in range(bits))


def mirror_code(code: int, bits: int) -> int:
    """Return the code that is read when the image is mirrored."""
    reversed_bits = int(format(code, f"0{bits}b")[::-1], 2)
    return smallest_rotation(reversed_bits, bits)


@cache
def _codes(maker: Maker, bits: int) -> NDArray[np.int64]:
    """Return all admitted codes, ascending, by the maker's rule: (N,), read-only."""
    # Every smallest rotation but 0 and all ones starts with a clear bit and ends with a set one.
    values = np.arange(1, 1 << (bits - 1), 2, dtype=np.int64)
    parity = values.copy()
    for shift in (16, 8, 4, 2, 1):
        parity ^= parity >> shift
    values = values[(parity & 1) == 0]
    half = bits // 2
    if maker == "aicon":
        values = values[(values & (values >> half) & ((1 << half) - 1)) != 0]
    else:
        values = values[values > (1 << half) + 1]
    mask = (1 << bits) - 1
    rotated = values.copy()
    for _ in range(bits - 1):
        rotated = ((rotated << 1) | (rotated >> (bits - 1))) & mask
        kept = rotated >= values
        values, rotated = values[kept], rotated[kept]
    values.setflags(write=False)
    return values


@lru_cache(maxsize=4096)
def _id_of(maker: Maker, bits: int, code: int) -> int | None:
    codes = _codes(maker, bits)
    smallest = smallest_rotation(code, bits)
    rank = int(np.searchsorted(codes, smallest))
    return rank + 1 if rank < len(codes) and int(codes[rank]) == smallest else None


@dataclass(frozen=True, kw_only=True)
class TargetFamily:
    """One family of ring-coded targets.

    Attributes
    ----------
    name : such as ``metashape12``.
    maker : whose rule admits the codes.
    bits : number of sectors n.
    ring_inner_ratio, ring_outer_ratio : the ring's radii in units of the dot's radius.
    """

    name: str
    maker: Maker
    bits: int
    ring_inner_ratio: float
    ring_outer_ratio: float

    @classmethod
    def by_name(cls, name: str) -> TargetFamily:
        """Return the family of a name such as ``aicon14``.

        Raises
        ------
        InputError
            If there is no such family.
        """
        for maker in ("aicon", "metashape"):
            for bits in BITS:
                if name == f"{maker}{bits}":
                    inner, outer = _RING[maker]
                    return cls(
                        name=name,
                        maker=maker,
                        bits=bits,
                        ring_inner_ratio=inner,
                        ring_outer_ratio=outer,
                    )
        raise InputError(
            f"Expected one of the target families {', '.join(family_names())}, got {name!r}: "
            "it is printed on the targets' packing or in the program that made them."
        )

    @property
    def read_ratio(self) -> float:
        """Radius at which the ring is read, in units of the dot's radius."""
        return 0.5 * (self.ring_inner_ratio + self.ring_outer_ratio)

    @property
    def codes(self) -> NDArray[np.int64]:
        """All codes in ascending order (shape (N,)); the number of ``codes[i]`` is i + 1."""
        return _codes(self.maker, self.bits)

    def __len__(self) -> int:
        """Return how many numbers the family has."""
        return len(self.codes)

    def code_of(self, target_id: int) -> int:
        """Return the code of a number.

        Raises
        ------
        InputError
            If the family does not have the number.
        """
        if not 1 <= target_id <= len(self.codes):
            raise InputError(
                f"Expected a number of {self.name} from 1 to {len(self.codes)}, got {target_id}: "
                "check the number and the family."
            )
        return int(self.codes[target_id - 1])

    def id_of(self, code: int) -> int | None:
        """Return the number of a code in any rotation, or None where the family lacks it."""
        return _id_of(self.maker, self.bits, code)


def family_names() -> tuple[str, ...]:
    """Return the names of all families."""
    return tuple(f"{maker}{bits}" for maker in ("aicon", "metashape") for bits in BITS)
