"""What an MTConnect agent says, as Python objects: its device model and its observations.

Namespaces differ with every version of the standard (1.3 to 2.x) and are passed over.
"""

from __future__ import annotations

import calendar
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass

from omm_core.errors import DeviceError, InputError

UNITS = {
    "MILLIMETER": 1.0,
    "MILLIMETER_3D": 1.0,
    "METER": 1000.0,
    "INCH": 25.4,
    "RADIAN": 1.0,
    "DEGREE": 0.017453292519943295,
}
_EVENTS = {
    "EXECUTION": "execution",
    "CONTROLLER_MODE": "mode",
    "PROGRAM": "program",
    "LINE": "line",
    "LINE_NUMBER": "line",
    "AVAILABILITY": "availability",
}
_STAMP = re.compile(r"(\d+)-(\d+)-(\d+)T(\d+):(\d+):(\d+)(?:\.(\d+))?Z?")


@dataclass(frozen=True, kw_only=True)
class Item:
    """What one data item of the device means to us."""

    role: str
    """``measured``, ``commanded``, ``path``, ``axis_state``, or an event of the controller."""
    axis: str = ""
    scale: float = 1.0


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
    observations: tuple[Observation, ...]


def read_device(text: bytes, name: str) -> dict[str, Item]:
    """Items of the device model by their id (answer to ``/probe``).

    Raises
    ------
    InputError
        Where there is no such device, or it tells no positions of axes in machine coordinates.
    """
    root = _parse(text)
    devices = [e for e in root.iter() if _tag(e) == "Device"]
    chosen = [d for d in devices if name in ("", d.get("name"), d.get("uuid"))]
    if len(chosen) != 1:
        raise InputError(
            f"MTConnect: expected one device{f' named {name}' if name else ''}, the agent has "
            f"{', '.join(str(d.get('name')) for d in devices) or 'none'}. Set mtconnect_device."
        )
    items: dict[str, Item] = {}
    for component in chosen[0].iter():
        if _tag(component) in ("Linear", "Rotary"):
            items |= _axis_items(component)
        elif _tag(component) in ("Device", "Controller", "Path"):
            items |= _controller_items(component)
    if not any(item.role in ("measured", "path") for item in items.values()):
        raise InputError(
            "MTConnect: expected axes with positions in machine coordinates, got none."
        )
    return items


def _axis_items(component: ET.Element) -> dict[str, Item]:
    """Best position of each kind: in machine coordinates, or where nothing else is said."""
    axis = component.get("name") or component.get("nativeName") or ""
    best: dict[str, tuple[int, str, Item]] = {}
    for data in _data_items(component):
        kind, subtype = data.get("type"), data.get("subType", "ACTUAL")
        if kind == "AXIS_STATE":
            best["axis_state"] = (0, data.get("id", ""), Item(role="axis_state", axis=axis))
        if kind not in ("POSITION", "ANGLE") or subtype not in ("ACTUAL", "COMMANDED"):
            continue
        rank = {"MACHINE": 0, None: 1}.get(data.get("coordinateSystem"))
        if rank is None:  # WORK: moves with every offset
            continue
        role = "measured" if subtype == "ACTUAL" else "commanded"
        item = Item(role=role, axis=axis, scale=_scale(data))
        if role not in best or rank < best[role][0]:
            best[role] = (rank, data.get("id", ""), item)
    return {item_id: item for _, item_id, item in best.values()}


def _controller_items(component: ET.Element) -> dict[str, Item]:
    items = {}
    for data in _data_items(component):
        kind, subtype = data.get("type", ""), data.get("subType")
        if kind in _EVENTS and subtype in (None, "ABSOLUTE", "MAIN", "ACTIVE"):
            items[data.get("id", "")] = Item(role=_EVENTS[kind])
        if kind == "PATH_POSITION" and subtype in (None, "ACTUAL"):
            items[data.get("id", "")] = Item(role="path", scale=_scale(data))
    return items


def _data_items(component: ET.Element) -> Iterator[ET.Element]:
    """Data items of a component itself, not of those below it."""
    for child in component:
        if _tag(child) == "DataItems":
            yield from (item for item in child if _tag(item) == "DataItem")


def _scale(data: ET.Element) -> float:
    unit = data.get("units", "MILLIMETER")
    if unit not in UNITS:
        raise InputError(
            f"MTConnect: expected {data.get('id')} in {', '.join(UNITS)}, it is in {unit}."
        )
    return UNITS[unit]


def read_document(text: bytes) -> Document:
    """Observations of a streams document, in the order of their sequence.

    Raises
    ------
    DeviceError
        Where the agent reports an error, or what it sends is no document.
    """
    root = _parse(text)
    header = next((e for e in root if _tag(e) == "Header"), None)
    if _tag(root) != "MTConnectStreams" or header is None:
        errors = [f"{e.get('errorCode')}: {e.text}" for e in root.iter() if e.get("errorCode")]
        raise DeviceError(f"MTConnect: the agent says {'; '.join(errors) or _tag(root)}.")
    observed = [
        Observation(
            item_id=element.get("dataItemId", ""),
            sequence=int(element.get("sequence", "0")),
            stamp_ns=stamp_ns(element.get("timestamp", "")),
            text=(element.text or "").strip(),
        )
        for element in root.iter()
        if element.get("dataItemId") and element.get("sequence")
    ]
    return Document(
        instance_id=header.get("instanceId", ""),
        first_sequence=int(header.get("firstSequence", "0")),
        next_sequence=int(header.get("nextSequence", "0")),
        observations=tuple(sorted(observed, key=lambda o: o.sequence)),
    )


def stamp_ns(text: str) -> int:
    """Nanoseconds since the epoch of a timestamp with any number of decimals."""
    match = _STAMP.match(text)
    if match is None:
        raise DeviceError(f"MTConnect: expected a timestamp, got {text!r}.")
    *whole, fraction = match.groups()
    seconds = calendar.timegm(tuple(int(word) for word in whole))
    return seconds * 1_000_000_000 + int((fraction or "0").ljust(9, "0")[:9])


def _parse(text: bytes) -> ET.Element:
    try:
        return ET.fromstring(text)
    except ET.ParseError as error:
        raise DeviceError(f"MTConnect: the agent sent no XML: {error}.") from error


def _tag(element: ET.Element) -> str:
    return str(element.tag).rpartition("}")[2]
