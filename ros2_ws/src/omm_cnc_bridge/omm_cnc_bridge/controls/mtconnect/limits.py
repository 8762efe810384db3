"""What an MTConnect model says of how a value is reported: filters and constraints.

| in the model | means | here |
|---|---|---|
| Filter MINIMUM_DELTA (units of the item) | smaller changes are not reported | unseen distance |
| Filter PERIOD (s), sampleRate below 10 Hz | changes come this often at most | unseen time |
| significantDigits | values are rounded to them | unseen distance, by the value |
| Constraints Minimum, Maximum | the values that are valid | others are none |
| Constraints Value, one | a constant: nothing is measured | unfit |
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field, replace

from omm_cnc_bridge.control import Unseen

SLOWEST_HZ = 10.0
"""A sampleRate from here on is what the agent's heartbeats and the dwell make up for."""


class Unfit(Exception):
    """A data item is not a position in machine coordinates; the text says why."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """How a data item is reported; values in its own units."""

    unseen: Unseen = field(default_factory=Unseen)
    least: float = -math.inf
    most: float = math.inf
    digits: int = 0
    """To so many significant digits values are rounded; 0: not told."""

    def unseen_at(self, value: float, scale: float) -> Unseen:
        """Return what is hidden where the axis is; ``scale`` makes mm or rad of its values."""
        if not self.digits or value == 0.0:
            return self.unseen
        step = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - self.digits)
        whys = (self.unseen.why, f"significantDigits {self.digits}")
        return replace(
            self.unseen,
            distance=max(self.unseen.distance, step * scale),
            why=", ".join(filter(None, whys)),
        )


def limits_of(data: ET.Element, scale: float) -> Limits:
    """Return how a data item is reported.

    Parameters
    ----------
    data : Element
        The data item.
    scale : float
        What makes mm or rad of its values.

    Raises
    ------
    Unfit
        Where it is a constant, or says something that is not understood.
    """
    within = {"Minimum": -math.inf, "Maximum": math.inf}
    values = 0
    for element in data.iter():
        values += _tag(element) == "Value"
        if _tag(element) in within:
            within[_tag(element)] = _value_of(element)
    if values == 1:
        raise Unfit("is a constant (Constraints, Value): nothing is measured")
    digits = _number(data.get("significantDigits")) or 0.0
    return Limits(
        unseen=_unseen(data, scale),
        least=within["Minimum"],
        most=within["Maximum"],
        digits=int(digits) if 1.0 <= digits <= 99.0 else 0,
    )


def _unseen(data: ET.Element, scale: float) -> Unseen:
    distance, seconds, why = 0.0, 0.0, []
    for element in data.iter():
        if _tag(element) != "Filter":
            continue
        kind, value = element.get("type", ""), _value_of(element)
        if not value >= 0.0 or kind not in ("MINIMUM_DELTA", "PERIOD"):
            raise Unfit(f"has a filter that is not understood ({kind or 'of no type'} {value:g})")
        why.append(f"filter {kind} {value:g}")
        if kind == "MINIMUM_DELTA":
            distance = max(distance, value * scale)
        else:
            seconds = max(seconds, value)
    rate_hz = _number(data.get("sampleRate"))
    if rate_hz is not None and 0.0 < rate_hz < SLOWEST_HZ:
        seconds = max(seconds, 1.0 / rate_hz)
        why.append(f"sampleRate {rate_hz:g}")
    return Unseen(distance=distance, seconds=seconds, why=", ".join(why))


def _value_of(element: ET.Element) -> float:
    value = _number(element.text)
    if value is None:
        raise Unfit(f"has a {_tag(element)} of {(element.text or '')[:80]!r}, which is no number")
    return value


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _tag(element: ET.Element) -> str:
    return str(element.tag).rpartition("}")[2]
