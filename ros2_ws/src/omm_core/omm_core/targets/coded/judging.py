"""From a candidate to a number that can be trusted.

Each step either hands on or gives a reason that a person understands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.targets.coded import ring_facts
from omm_core.targets.coded.families import TargetFamily
from omm_core.targets.coded.reading import read_candidates, read_ring
from omm_core.targets.coded.ring_profile import SAMPLES
from omm_core.targets.coded.uneven import read_uneven
from omm_core.targets.coded.uneven_outline import grey_unit, outline_uneven
from omm_core.targets.conic.outline import semi_axes, square_root, within_any
from omm_core.targets.detected import RefusedTarget
from omm_core.words import Words, keyed

Floats = NDArray[np.float64]

LEAN_RADIUS_PX = 24.0
"""Smaller semi-axis from which on perspective is looked for within a target."""
LEANS = np.array([-0.06, -0.04, -0.02, 0.0, 0.02, 0.04, 0.06])
"""Radius of the dot by its distance that is tried (a dot of 15 mm at 150 mm: 0.05)."""
_FROM_THE_MIDDLE = (2, 4, 1, 5, 0, 6)
MIN_LEAN_GAIN = 0.9
"""By how much the ring must fit better with perspective (of the squared error) to believe it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RingReading:
    """A dot with a ring that was read.

    Attributes
    ----------
    outline : (9,) see `outline.outline`.
    lean : (2,) the perspective's share, see `ring_profile`.
    sign : +1 bright dot, -1 dark dot.
    bits : (n,) 0/1 clockwise from `phase_rad`, as seen; not yet rotated to the code.
    uneven : whether it could be read only as one on which the light falls off.
    """

    id: int
    outline: Floats
    lean: Floats
    sign: int
    bits: NDArray[np.int64]
    phase_rad: float
    margin: float
    uneven: bool = False

    @property
    def radius_px(self) -> float:
        """Radius of the circle with the ellipse's area."""
        return radius(self.outline)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """What is seen of a candidate: `read_ring`'s bits and facts, what speaks against it."""

    shape: Floats
    bits: NDArray[np.int64]
    facts: Floats
    against: int
    lean: Floats = field(default_factory=lambda: np.zeros(2))
    uneven: bool = False


def radius(conic: Floats) -> float:
    """Return the radius of the circle with the area of the ellipse (5,), px."""
    return float((conic[2] * conic[4] - conic[3] ** 2) ** -0.25)


def refusal(conic: Floats, reason: Words) -> RefusedTarget:
    """Return the refusal of an ellipse (5,) that is not taken for a target."""
    return RefusedTarget(center_px=conic[:2].copy(), diameter_px=2.0 * radius(conic), reason=reason)


def judge_candidates(
    image: NDArray[Any], family: TargetFamily, candidates: Floats
) -> tuple[list[RingReading], list[RefusedTarget]]:
    """Return outlines and numbers of the candidates (N, 6), and what was refused.

    Large candidates are judged first.
    """
    dots, shapes, bits, facts, doubts = read_candidates(
        image, candidates, family.ring_inner_ratio, family.ring_outer_ratio, family.bits
    )
    readings: list[RingReading] = []
    rings = np.empty((len(dots), 5))
    refused = []
    for i, shape in enumerate(shapes):
        if within_any(rings, len(readings), shape[0], shape[1], family.ring_outer_ratio):
            continue
        candidate = candidates[dots[i]]
        seen = _Seen(shape=shape, bits=bits[i], facts=facts[i], against=int(doubts[i]))
        # Perspective blurs a ring; it does not make one of nothing, or of the image's border.
        if seen.against not in (ring_facts.CUT, ring_facts.NO_RING, ring_facts.NO_DOT):
            lean = _perspective(image, family, shape, seen.facts)
            seen = seen if lean is None else _read(image, family, shape, lean)
        if seen.against in _MAY_BE_LIGHT:
            seen = _uneven(image, family, candidate) or seen
        if seen.against in (ring_facts.NO_RING, ring_facts.NO_DOT):
            continue  # nothing ring-like is there, which is not worth a word
        outcome = _number(family, seen, int(candidate[5]))
        if isinstance(outcome, RingReading):
            rings[len(readings)] = seen.shape[:5]
            readings.append(outcome)
        else:
            refused.append(outcome)
    return readings, refused


_MAY_BE_LIGHT = (
    ring_facts.UNCLEAR,
    ring_facts.COVERED,
    ring_facts.NO_RING,
    ring_facts.SHADED,
    ring_facts.NO_DOT,
)
_DOUBTS = {
    ring_facts.CUT: keyed("said.ring_cut", "the ring is cut by the border of the image"),
    ring_facts.UNCLEAR: keyed("said.ring_unclear", "a sector of the ring is neither set nor clear"),
    ring_facts.COVERED: keyed(
        "said.ring_covered",
        "the ring does not match its own bits: something lies on it, or light falls on it",
    ),
    ring_facts.FILLED: keyed("said.ring_filled", "something lies between dot and ring"),
    ring_facts.SHADED: keyed(
        "said.ring_shaded", "a shadow lies on the ring: what is dark there may be set"
    ),
}


def _number(family: TargetFamily, seen: _Seen, sign: int) -> RingReading | RefusedTarget:
    """Return a reading, or a refusal."""
    shape = seen.shape
    if seen.against == ring_facts.OTHER_WIDTH:
        words = keyed(
            "said.ring_width", "the ring is not as wide as those of {family}", family=family.name
        )
        return refusal(shape, words)
    if seen.against != ring_facts.NONE:
        return refusal(shape, _DOUBTS[seen.against])
    code = int("".join(map(str, seen.bits)), 2)
    target_id = family.id_of(code)
    if target_id is None:
        words = keyed(
            "said.ring_code",
            "the ring reads {code}: no code of {family}",
            code=f"{code:0{family.bits}b}", family=family.name,
        )  # fmt: skip
        return refusal(shape, words)
    return RingReading(
        id=target_id,
        outline=shape,
        lean=seen.lean,
        sign=sign,
        bits=seen.bits,
        phase_rad=float(seen.facts[ring_facts.PHASE]),
        margin=float(seen.facts[ring_facts.MARGIN]),
        uneven=seen.uneven,
    )


def _perspective(
    image: NDArray[Any], family: TargetFamily, shape: Floats, straight: Floats
) -> Floats | None:
    """Return how much larger a tilted target's near side is, (2,) per dot radius.

    It lies along the ellipse's smaller axis. None where there is none to be seen, as of a small
    dot, which is far away.
    """
    if radius(shape) < LEAN_RADIUS_PX:
        return None
    smaller, larger = semi_axes(shape[2], shape[3], shape[4])
    if smaller < LEAN_RADIUS_PX or larger < 1.04 * smaller:
        return None
    a11, a12, a22 = square_root(shape[2], shape[3], shape[4])
    angle = 0.5 * math.atan2(2.0 * a12, a11 - a22) + 0.5 * math.pi
    axis = np.array([math.cos(angle), math.sin(angle)])
    # Lean is the dot's radius by its distance, times the sine of the tilt.
    leans = LEANS * math.sqrt(1.0 - (smaller / larger) ** 2)
    middle = len(leans) // 2
    errors = np.full(len(leans), math.nan)
    errors[middle] = _ring_error(straight)
    for i in _FROM_THE_MIDDLE:
        errors[i] = _ring_error(_read(image, family, shape, leans[i] * axis).facts)
        # Where a ring is read and fits worse on both sides, it fits best as it is.
        near = errors[middle - 1 : middle + 2]
        if near[1] < 1.0 and near[0] >= near[1] <= near[2]:
            return None
    best = int(np.nanargmin(errors)) if np.isfinite(errors).any() else middle
    if errors[best] ** 2 > MIN_LEAN_GAIN * errors[middle] ** 2:
        return None
    if not 0 < best < len(leans) - 1 or not np.isfinite(errors[best - 1 : best + 2]).all():
        return np.asarray(leans[best] * axis)
    before, at, after = errors[best - 1 : best + 2] ** 2
    bend = before - 2.0 * at + after
    shift = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return np.asarray((leans[best] + shift * (leans[1] - leans[0])) * axis)


def _read(image: NDArray[Any], family: TargetFamily, shape: Floats, lean: Floats) -> _Seen:
    """Read the ring under even light."""
    ring = (family.ring_inner_ratio, family.ring_outer_ratio, family.bits)
    bits, facts = read_ring(image, shape, lean, np.empty((2, 0)), *ring)
    return _Seen(shape=shape, bits=bits, facts=facts, against=ring_facts.doubt(facts), lean=lean)


def _uneven(image: NDArray[Any], family: TargetFamily, candidate: Floats) -> _Seen | None:
    """Read a dot with a ring under light that falls across it; None where that leaves a doubt."""
    unit = grey_unit(image)
    shape, ok = outline_uneven(image, candidate, unit)
    if not ok:
        return None
    ring = np.array([family.ring_inner_ratio, family.ring_outer_ratio])
    light = np.empty((2, family.bits * SAMPLES))
    bits, facts, ok = read_uneven(image, shape, candidate[5], unit, ring, family.bits, light)
    if not ok:
        return None
    return _Seen(shape=shape, bits=bits, facts=facts, against=ring_facts.NONE, uneven=True)


def _ring_error(facts: Floats) -> float:
    """Return the RMS of the ring as seen less as its bits say; NaN outside the image."""
    if math.isnan(facts[ring_facts.PHASE]):
        return math.nan
    unread = facts[ring_facts.MARGIN] < 0.1 or facts[ring_facts.LARGEST] < 0.5
    return 1.0 if unread else float(facts[ring_facts.PROFILE_RMS])
