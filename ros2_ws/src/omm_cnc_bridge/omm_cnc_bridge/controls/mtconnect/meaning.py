"""What a data item of an MTConnect model means, from all that the model says of it.

A position that cannot be shown to be one of the machine's own is not used, and why is kept.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from omm_cnc_bridge.controls.mtconnect.limits import Limits, Unfit, limits_of

LENGTHS = {
    "MILLIMETER": 1.0,
    "CENTIMETER": 10.0,
    "METER": 1000.0,
    "INCH": 25.4,
}
ANGLES = {"RADIAN": 1.0, "DEGREE": 0.017453292519943295}
_OF_POINT = {"MILLIMETER_3D": 1.0, "INCH_3D": 25.4}
_UNITS_OF = {"POSITION": LENGTHS, "ANGLE": ANGLES, "PATH_POSITION": LENGTHS | _OF_POINT}
_TYPE_OF = {"Linear": "POSITION", "Rotary": "ANGLE"}
_POSITIONS = ("POSITION", "ANGLE")


@dataclass(frozen=True, kw_only=True)
class Item:
    """What one data item of the device means to us."""

    role: str
    """``measured``, ``commanded``, ``path``, ``axis_state``, or an event of the controller."""
    axis: str = ""
    scale: float = 1.0
    turns: bool = False
    limits: Limits = field(default_factory=Limits)


@dataclass(frozen=True, kw_only=True)
class Device:
    """The data items that are read, and the axes that none of them tells of."""

    items: Mapping[str, Item]
    unusable: Mapping[str, str] = field(default_factory=dict)
    """Why no position of an axis can be used, by its name."""
    notes: tuple[str, ...] = ()
    """What was chosen where the model says a thing twice."""


@dataclass(frozen=True, kw_only=True)
class _Candidate:
    rank: tuple[int, int]
    """How plainly the model says that it is what we want; the smallest wins."""
    item_id: str
    item: Item


def coordinate_systems(device: ET.Element) -> dict[str, str]:
    """Return the type of each coordinate system that the device defines (2.x), by its id.

    One of type MACHINE that lies in another of that type is not the machine's own.
    """
    found = [e for e in device.iter() if tag(e) == "CoordinateSystem"]
    types = {e.get("id", ""): e.get("type") or "untold" for e in found}
    parents = {e.get("id", ""): e.get("parentIdRef") for e in found}
    for system in [name for name, kind in types.items() if kind == "MACHINE"]:
        parent, below = parents[system], {system}
        while parent is not None and parent not in below:
            if types.get(parent, "").startswith("MACHINE"):
                types[system] = f"MACHINE in {parent}"
            below.add(parent)
            parent = parents.get(parent)
    return types


def name_of(component: ET.Element) -> str:
    """Return an axis's name; its id where it has none."""
    return component.get("name") or component.get("nativeName") or component.get("id") or ""


def axis_items(component: ET.Element, systems: Mapping[str, str]) -> Device:
    """Return the one measured and the one commanded position of an axis, in machine coordinates."""
    axis = name_of(component)
    found: dict[str, list[_Candidate]] = {"measured": [], "commanded": []}
    items: dict[str, Item] = {}
    reasons: list[str] = []
    for data in data_items(component):
        if data.get("type") == "AXIS_STATE" and _is_value(data, "EVENT"):
            items[data.get("id", "")] = Item(role="axis_state", axis=axis)
        if data.get("type") not in _POSITIONS or data.get("category") == "CONDITION":
            continue
        try:
            candidate = _candidate(data, tag(component), axis, systems)
            found[candidate.item.role].append(candidate)
        except Unfit as error:
            reasons.append(f"{data.get('id')} {error}")
    for role, candidates in found.items():
        try:
            items |= _best(candidates)
        except Unfit as error:
            reasons.append(str(error))
            found[role] = []
    if found["commanded"] and not found["measured"]:
        reasons.append("only the commanded position is told")
    if reasons and not found["measured"]:
        return Device(items=items, unusable={axis: "; ".join(reasons)})
    return Device(items=items)


def path_item(data: ET.Element, systems: Mapping[str, str]) -> Item:
    """Return the tool point of a path; raise Unfit unless it is in machine coordinates.

    Without a word the standard has it in WORK coordinates, which move with every offset.
    """
    _check_sample(data)
    if data.get("subType") not in (None, "ACTUAL"):
        raise Unfit(f"is {data.get('subType')}, not ACTUAL")
    if _system_rank(data, systems) != 0:
        raise Unfit("says no coordinate system, which is WORK for a path")
    scale = _scale(data)
    return Item(role="path", scale=scale, limits=limits_of(data, scale))


def data_items(component: ET.Element) -> Iterator[ET.Element]:
    """Yield the data items of a component itself, not of those below it."""
    for child in component:
        if tag(child) == "DataItems":
            yield from (item for item in child if tag(item) == "DataItem")


def tag(element: ET.Element) -> str:
    """Return an element's name without its namespace, which differs with every version."""
    return str(element.tag).rpartition("}")[2]


def join(axes: list[tuple[ET.Element, Device]]) -> Device:
    """Join all axes into one device; those that share a name are told apart by their ids.

    Of X of two paths nothing says which moves the spindle: they become X@ID, which the machine's
    file must name.
    """
    items: dict[str, Item] = {}
    unusable: dict[str, str] = {}
    told = [(component, device) for component, device in axes if _tells(device)]
    names = [name_of(component) for component, _ in told]
    notes = []
    for _, device in axes:
        items |= device.items if not _tells(device) else {}
    for component, device in told:
        plain = name = name_of(component)
        if names.count(plain) > 1:
            name = f"{plain}@{component.get('id', '')}"
            notes.append(
                f"the agent's model has {names.count(plain)} axes {plain}; nothing says which moves"
                f" the spindle: this one is called {name}"
            )
        items |= {i: replace(item, axis=name) for i, item in device.items.items()}
        unusable |= dict.fromkeys(
            [name] if device.unusable else [], "; ".join(device.unusable.values())
        )
    return Device(items=items, unusable=unusable, notes=tuple(notes))


def _tells(device: Device) -> bool:
    return bool(device.unusable) or any(i.role == "measured" for i in device.items.values())


def _candidate(
    data: ET.Element, component: str, axis: str, systems: Mapping[str, str]
) -> _Candidate:
    _check_sample(data)
    kind, subtype = data.get("type", ""), data.get("subType")
    if subtype not in (None, "ACTUAL", "COMMANDED"):
        raise Unfit(f"is {subtype}, not ACTUAL")
    if kind != _TYPE_OF[component]:
        raise Unfit(f"is of type {kind}, a {component} axis has a {_TYPE_OF[component]}")
    if data.get("compositionId"):
        raise Unfit(f"is of the part {data.get('compositionId')} of the axis only")
    rank = _system_rank(data, systems), int(subtype is None)
    role = "commanded" if subtype == "COMMANDED" else "measured"
    scale = _scale(data)
    item = Item(
        role=role,
        axis=axis,
        scale=scale,
        turns=component == "Rotary",
        limits=limits_of(data, scale),
    )
    return _Candidate(rank=rank, item_id=data.get("id", ""), item=item)


def _check_sample(data: ET.Element) -> None:
    """Raise Unfit where a data item is not one plain number or point."""
    if data.get("category") != "SAMPLE":
        raise Unfit(f"has the category {data.get('category')}, not SAMPLE")
    if data.get("representation") not in (None, "VALUE"):
        raise Unfit(f"is a {data.get('representation')}, not one value")
    if data.get("statistic"):
        raise Unfit(f"is a statistic ({data.get('statistic')}), not what is measured now")


def _is_value(data: ET.Element, category: str) -> bool:
    plain = data.get("representation") in (None, "VALUE")
    return plain and data.get("category") in (None, category)


def _system_rank(data: ET.Element, systems: Mapping[str, str]) -> int:
    """Return 0 where machine coordinates are declared, 1 (the standard's default) otherwise.

    Raises
    ------
    Unfit
        Where it is another coordinate system, one that is not defined, or two that differ.
    """
    told, reference = data.get("coordinateSystem"), data.get("coordinateSystemIdRef")
    if told not in (None, "MACHINE"):
        raise Unfit(f"is in {told or 'untold'} coordinates")
    if reference is None:
        return 1 if told is None else 0
    if reference not in systems:
        raise Unfit(f"is in the coordinate system {reference}, which the model does not define")
    if systems[reference] != "MACHINE":
        raise Unfit(f"is in {systems[reference]} coordinates ({reference})")
    return 0


def _scale(data: ET.Element) -> float:
    """Return the factor to mm or rad; raise Unfit where the unit is missing or another type's."""
    units, unit = _UNITS_OF[data.get("type", "")], data.get("units")
    if unit not in units:
        raise Unfit(f"is in {unit or 'no unit'}, expected {', '.join(units)}")
    return units[unit]


def _best(candidates: list[_Candidate]) -> dict[str, Item]:
    """Return the plainest item; raise Unfit where two are equally plain."""
    if not candidates:
        return {}
    least = min(c.rank for c in candidates)
    best = [c for c in candidates if c.rank == least]
    if len(best) > 1:
        ids = ", ".join(c.item_id for c in best)
        raise Unfit(f"{ids}: the model does not say which is the axis's {best[0].item.role} one")
    return {best[0].item_id: best[0].item}
