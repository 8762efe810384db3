"""What an MTConnect agent says, as Python objects: its device model and its observations.

Namespaces differ with every version of the standard (1.3 to 2.x) and are passed over.
"""

from __future__ import annotations

import calendar
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace

from omm_cnc_bridge.controls.mtconnect.limits import Unfit
from omm_cnc_bridge.controls.mtconnect.meaning import (
    Device,
    Item,
    axis_items,
    coordinate_systems,
    data_items,
    join,
    path_item,
    tag,
)
from omm_core.errors import DeviceError, InputError

_EVENTS = {
    "EXECUTION": "execution",
    "CONTROLLER_MODE": "mode",
    "PROGRAM": "program",
    "LINE": "line",
    "LINE_NUMBER": "line",
    "AVAILABILITY": "availability",
}
_STAMP = re.compile(r"(\d{4})-(\d\d?)-(\d\d?)T(\d\d?):(\d\d?):(\d\d?)(?:\.(\d+))?Z?", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Observation:
    """One value that the agent reports."""

    item_id: str
    sequence: int
    stamp_ns: int
    """Of the agent's or the adapter's clock."""
    text: str


@dataclass(frozen=True, kw_only=True)
class Document:
    """One answer of the agent, or one part of a stream."""

    instance_id: str
    first_sequence: int
    next_sequence: int
    buffer_size: int
    """How many observations the agent keeps; 0 where it does not tell."""
    observations: tuple[Observation, ...]


def read_device(text: bytes, name: str) -> Device:
    """Return what is read of the device (answer to ``/probe``).

    Raises
    ------
    InputError
        Where there is no such device, or it tells no positions of axes in machine coordinates.
    """
    root = _parse(text)
    if tag(root) != "MTConnectDevices":
        raise DeviceError(f"MTConnect: the agent says {_words_of(root)}.")
    devices = [e for e in root.iter() if tag(e) == "Device"]
    chosen = [d for d in devices if name in ("", d.get("name"), d.get("uuid"))]
    if len(chosen) != 1:
        raise InputError(
            f"MTConnect: expected one device{f' named {name}' if name else ''}, the agent has "
            f"{', '.join(str(d.get('name')) for d in devices) or 'none'}. Set mtconnect_device."
        )
    systems = coordinate_systems(chosen[0])
    axes: list[tuple[ET.Element, Device]] = []
    events: dict[str, Item] = {}
    reasons: list[str] = []
    for component in chosen[0].iter():
        if tag(component) in ("Linear", "Rotary"):
            axes.append((component, axis_items(component, systems)))
        elif tag(component) in ("Device", "Controller", "Path"):
            events |= _controller_items(component, systems, reasons)
    device = join(axes)
    items = {**device.items, **_one_tool_point(events, reasons)}
    reasons += [f"{axis}: {why}" for axis, why in device.unusable.items()]
    if not any(item.role in ("measured", "path") for item in items.values()):
        raise InputError(
            "MTConnect: expected axes with positions in machine coordinates, got none"
            f"{': ' if reasons else ''}{'; '.join(reasons)}."
        )
    return replace(device, items=items)


def _one_tool_point(events: dict[str, Item], reasons: list[str]) -> dict[str, Item]:
    """Return the items with one tool point at most: which of several is meant nothing tells."""
    points = [name for name, item in events.items() if item.role == "path"]
    if len(points) < 2:
        return events
    reasons.append(f"{', '.join(points)}: the model does not say which tool point is the spindle's")
    return {name: item for name, item in events.items() if name not in points}


def _controller_items(
    component: ET.Element, systems: dict[str, str], reasons: list[str]
) -> dict[str, Item]:
    items = {}
    for data in data_items(component):
        kind, subtype = data.get("type", ""), data.get("subType")
        if data.get("category") == "CONDITION":
            continue
        if kind in _EVENTS and subtype in (None, "ABSOLUTE", "MAIN", "ACTIVE"):
            items[data.get("id", "")] = Item(role=_EVENTS[kind])
        if kind == "PATH_POSITION":
            try:
                items[data.get("id", "")] = path_item(data, systems)
            except Unfit as error:
                reasons.append(f"{data.get('id')} {error}")
    return items


def read_document(text: bytes) -> Document:
    """Return the observations of a streams document, in the order of their sequence.

    Raises
    ------
    DeviceError
        Where the agent reports an error, or what it sends is not a document.
    """
    root = _parse(text)
    header = next((e for e in root if tag(e) == "Header"), None)
    if tag(root) != "MTConnectStreams" or header is None:
        raise DeviceError(f"MTConnect: the agent says {_words_of(root)}.")
    observed = [
        Observation(
            item_id=element.get("dataItemId", ""),
            sequence=_count(element, "sequence"),
            stamp_ns=stamp_ns(element.get("timestamp", "")),
            text=_text(element),
        )
        for element in root.iter()
        if element.get("dataItemId") and element.get("sequence")
    ]
    following, last = _count(header, "nextSequence"), _count(header, "lastSequence")
    if header.get("lastSequence") and following > last + 1:
        # Believed, it would have all that comes until then passed over as known.
        raise DeviceError(
            f"MTConnect: expected the next sequence behind the last one ({last}), got {following}."
        )
    return Document(
        instance_id=header.get("instanceId", ""),
        first_sequence=_count(header, "firstSequence"),
        next_sequence=following,
        buffer_size=_count(header, "bufferSize"),
        observations=tuple(sorted(observed, key=lambda o: o.sequence)),
    )


def _text(element: ET.Element) -> str:
    """Return what was observed; no value where the agent itself calls it invalid (2.x)."""
    text = (element.text or "").strip()
    return f"INVALID: {text}" if element.get("quality") == "INVALID" else text


def stamp_ns(text: str) -> int:
    """Return a timestamp, with any number of decimals, as nanoseconds since the epoch."""
    match = _STAMP.match(text)
    if match is None:
        raise DeviceError(f"MTConnect: expected a timestamp, got {text[:80]!r}.")
    *whole, fraction = match.groups()
    try:
        seconds = calendar.timegm(tuple(int(word) for word in whole))
    except (ValueError, OverflowError):
        raise DeviceError(f"MTConnect: expected a timestamp, got {text[:80]!r}.") from None
    return seconds * 1_000_000_000 + int((fraction or "0").ljust(9, "0")[:9])


def _words_of(root: ET.Element) -> str:
    """Return the agent's own words (1.x: the element's text; 2.x: an element below it)."""
    errors = [
        f"{e.get('errorCode')}: {' '.join(' '.join(e.itertext()).split())}"
        for e in root.iter()
        if e.get("errorCode")
    ]
    return "; ".join(errors) or tag(root)


def _count(element: ET.Element, name: str) -> int:
    text = element.get(name, "0")
    if not (text.isascii() and text.isdecimal() and len(text) < 20):
        raise DeviceError(f"MTConnect: expected a number as {name}, got {text[:80]!r}.")
    return int(text)


def _parse(text: bytes) -> ET.Element:
    try:
        return ET.fromstring(text)
    # The last two: an encoding that Python does not know.
    except (ET.ParseError, ValueError, LookupError) as error:
        raise DeviceError(f"MTConnect: the agent sent no XML: {error}.") from error
