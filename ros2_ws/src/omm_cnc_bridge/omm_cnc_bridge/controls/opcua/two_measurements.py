"""Which of an axis's two measured positions is to be believed.

OPC 40502 has PosDirect (the scale) and PosIndirect (the motor's encoder). That a node exists does
not mean that something measures behind it: machines without a scale say 0.0 there, for ever.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

AGREEMENT = {False: 0.5, True: 2e-3}
"""How far the two may be apart (lost motion, warm ball screws), mm and rad."""
MOTION = {False: 0.01, True: 1e-4}
"""What counts as motion of one, at which the other must move too, mm and rad."""


@dataclass(frozen=True, kw_only=True)
class AxisReading:
    """What one of the two says now, mm or rad."""

    actual: float | None
    """None where there is no good number."""
    commanded: float | None = None
    why_not: str = ""
    """Why there is none."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What is believed."""

    name: str
    """``PosDirect``, ``PosIndirect``, or empty: neither is."""
    why: str


class OneMeasurement:
    """Watches the only position of one axis: whether anything measures behind it."""

    def __init__(self, *, rotary: bool) -> None:
        self._rotary = rotary
        self._alive = False

    def refusal(self, reading: AxisReading) -> str:
        """Return why a position is not believed: 0 from the start, and commanded elsewhere."""
        self._alive |= bool(reading.actual)
        if self._alive or reading.actual is None or reading.commanded is None:
            return ""
        if abs(reading.commanded) <= AGREEMENT[self._rotary]:
            return ""
        unit = "rad" if self._rotary else "mm"
        return (
            f"says 0 and has said nothing else, while it is commanded to {reading.commanded:.4f} "
            f"{unit}; if nothing measures there, name the right node in the mapping file"
        )


class _Seen:
    """How far one of the two was seen to move."""

    def __init__(self) -> None:
        self._least, self._most = math.inf, -math.inf

    def add(self, value: float | None) -> None:
        if value is not None:
            self._least, self._most = min(self._least, value), max(self._most, value)

    @property
    def span(self) -> float:
        return max(0.0, self._most - self._least)


class TwoMeasurements:
    """Watches both positions of one axis, from sample to sample."""

    def __init__(self, *, rotary: bool) -> None:
        self._rotary = rotary
        self._direct, self._indirect = _Seen(), _Seen()

    def choose(self, direct: AxisReading, indirect: AxisReading) -> Choice:
        """Choose the direct one where it is alive and agrees; neither where they contradict."""
        self._direct.add(direct.actual)
        self._indirect.add(indirect.actual)
        if direct.actual is None and indirect.actual is None:
            why = f"PosDirect {direct.why_not}, PosIndirect {indirect.why_not}"
            return Choice(name="", why=why)
        if direct.actual is None:
            return Choice(name="PosIndirect", why=f"PosDirect {direct.why_not}")
        if indirect.actual is None:
            return Choice(name="PosDirect", why=f"PosIndirect {indirect.why_not}")
        return self._of_two(direct, indirect, direct.actual, indirect.actual)

    def _of_two(
        self, direct: AxisReading, indirect: AxisReading, at_direct: float, at_indirect: float
    ) -> Choice:
        moved = MOTION[self._rotary]
        if self._is_dead(self._direct, direct, self._indirect, indirect):
            why = f"PosDirect stays {at_direct:g} whatever the axis does"
            return Choice(name="PosIndirect", why=why)
        if self._is_dead(self._indirect, indirect, self._direct, direct):
            why = f"PosIndirect stays {at_indirect:g} whatever the axis does"
            return Choice(name="PosDirect", why=why)
        # A bare 0 that never moved shows nothing: the other must say the same, not nearly so.
        unproven = at_direct == 0.0 and self._direct.span == 0.0
        if abs(at_direct - at_indirect) <= (moved if unproven else AGREEMENT[self._rotary]):
            return Choice(name="PosDirect", why="PosIndirect agrees with it")
        unit = "rad" if self._rotary else "mm"
        why = (
            f"PosDirect says {at_direct:.4f} {unit} and PosIndirect {at_indirect:.4f} {unit}; "
            "name the right one in the mapping file"
        )
        return Choice(name="", why=why)

    def _is_dead(
        self, seen: _Seen, reading: AxisReading, other_seen: _Seen, other: AxisReading
    ) -> bool:
        """Return whether a value is dead: stood while the other moved, or is a bare 0."""
        moved = MOTION[self._rotary]
        if seen.span > 0.0:
            return False
        if other_seen.span > moved:
            return True
        if reading.actual != 0.0 or other.actual is None or other.commanded is None:
            return False
        follows_command = abs(other.actual - other.commanded) <= moved
        return follows_command and abs(other.actual) > moved
