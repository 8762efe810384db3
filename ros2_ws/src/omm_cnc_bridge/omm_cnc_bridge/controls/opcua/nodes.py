"""Find the nodes of axes, channel and spindle on an OPC UA server, and what their values mean.

Where the mapping names no axes, they are those of the server's CncInterface (OPC 40502).
"""

from __future__ import annotations

import math

from asyncua import Client, Node, ua

from omm_cnc_bridge.controls.opcua.addresses import Addresses, child
from omm_cnc_bridge.controls.opcua.mapping import (
    ANGLE_UNITS,
    TWICE,
    UNITS,
    AxisItems,
    Mapping40502,
)
from omm_cnc_bridge.controls.opcua.two_measurements import OneMeasurement, TwoMeasurements
from omm_core.errors import InputError

_UNIT_CODES = {
    "MMT": "mm", "MTR": "m", "INH": "inch", "4H": "um", "CMT": "cm", "C81": "rad", "DD": "deg"
}  # fmt: skip
_UNIT_WORDS = {
    "mm": "mm",
    "µm": "um",
    "cm": "cm",
    "m": "m",
    "in": "inch",
    "inch": "inch",
    "rad": "rad",
    "°": "deg",
    "deg": "deg",
}
_CHANNEL_NAMES = {
    "mode": "ActOperationMode",
    "program_status": "ActProgramStatus",
    "program": "ActMainProgramName",
    "program_line": "ActMainProgramLine",
}
_AXIS_NAMES = {
    "PosDirect": "PosDirect",
    "PosIndirect": "PosIndirect",
    "status": "ActStatus",
    "referenced": "IsReferenced",
    "virtual": "IsVirtual",
    "inactive": "IsInactive",
    "rotational": "IsRotational",
}
POSITIONS = ("position", *TWICE)
COMMANDED = {"position": "commanded", **{item: f"{item} commanded" for item in TWICE}}
Key = tuple[str, str]  # axis and item, or "" and an item of the channel
CLOCK: Key = ("", "clock")


class NodeFinder:
    """Finds nodes, and learns how their values are to be read.

    Attributes
    ----------
    scales : dict
        By usable axis: what makes mm or rad of its values.
    rest_values : dict
        By axis: the status that it has in position.
    unusable : dict
        By axis: why no position of it can be used.
    twice : dict
        By axis that is measured directly and indirectly: which of the two to take.
    once : dict
        By axis that is measured once: whether to take that.
    turning : dict
        By usable axis: whether it turns, by its unit.
    per_angle : float
        What makes rad of the spindle's angle.
    """

    def __init__(self, client: Client, mapping: Mapping40502, addresses: Addresses) -> None:
        self._client, self._mapping = client, mapping
        self.addresses = addresses
        self.scales: dict[str, float] = {}
        self.rest_values: dict[str, int] = {}
        self.unusable: dict[str, str] = {}
        self.twice: dict[str, TwoMeasurements] = {}
        self.once: dict[str, OneMeasurement] = {}
        self.turning: dict[str, bool] = {}
        self.per_angle = UNITS["deg"]

    async def nodes(self) -> dict[Key, Node]:
        """Return the nodes to subscribe to, by axis and item."""
        axes = dict(self._mapping.axes) or await self._browse_axes()
        nodes: dict[Key, Node] = {}
        for name, items in axes.items():
            nodes |= await self._axis_nodes(name, items)
        if not self.scales:
            reasons = "; ".join(f"axis {axis} {why}" for axis, why in self.unusable.items())
            raise InputError(f"OPC UA: expected axes that can be used: {reasons or 'none are'}.")
        _refuse_shared(nodes)
        nodes |= await self._channel_nodes()
        nodes[CLOCK] = self._client.get_node(ua.ObjectIds.Server_ServerStatus_CurrentTime)
        return nodes

    async def _interface(self) -> Node:
        """Return the server's CncInterface that has axes, at most three levels below Objects.

        OPC 40502's own nodeset brings an interface without any ("test") along.
        """
        level = [self._client.nodes.objects]
        for _ in range(3):
            below: list[Node] = []
            for node in level:
                axes = await child(node, "CncAxisList")
                if axes is not None and await axes.get_children(nodeclassmask=ua.NodeClass.Object):
                    return node
                if node.nodeid != ua.NodeId(ua.ObjectIds.Server):
                    below += await node.get_children()
            level = below
        raise InputError(
            "OPC UA: expected a CncInterface with a CncAxisList (OPC 40502), found none. Set "
            "opcua_mapping_file to a file that names the control's own nodes."
        )

    async def _browse_axes(self) -> dict[str, AxisItems]:
        axis_list = await self.addresses.find("CncAxisList", await self._interface())
        axes = {}
        for axis in await axis_list.get_children(nodeclassmask=ua.NodeClass.Object):
            paths = {}
            for item, name in _AXIS_NAMES.items():
                node = await child(axis, name)
                if node is not None:
                    paths[item] = await self.addresses.lasting(node)
            positions = [item for item in TWICE if item in paths]
            if len(positions) == 1:
                paths["position"] = paths.pop(positions[0])
            if positions:
                axes[(await axis.read_browse_name()).Name] = AxisItems(paths=paths)
        if not axes:
            raise InputError("OPC UA: expected axes in the CncAxisList, found it empty.")
        return axes

    async def _axis_nodes(self, name: str, items: AxisItems) -> dict[Key, Node]:
        nodes = {
            (name, item): await self.addresses.variable(path, f"the {item} of axis {name}")
            if self._mapping.axes
            else await self.addresses.find(path)  # found by browsing: it is there
            for item, path in items.paths.items()
        }
        self.rest_values[name] = items.in_position
        if await _says_true(nodes.pop((name, "virtual"), None)):
            return {}
        rotational = nodes.pop((name, "rotational"), None)
        turns = await _bool(rotational) if rotational is not None else None
        units: dict[str, str | None] = {}
        for item in POSITIONS:
            if (name, item) in nodes:
                units[item] = await self._split(name, item, nodes)
        if items.unit:
            units = dict.fromkeys(units, items.unit)
        elif len(units) > 1 and any(units.values()):
            units = _without_unitless(name, units, nodes)
        trouble = _unit_trouble(set(units.values()), turns)
        if trouble:
            self.unusable[name] = trouble
            inactive = nodes.get((name, "inactive"))
            return {} if inactive is None else {(name, "inactive"): inactive}
        unit = str(next(iter(units.values())))
        self.scales[name] = UNITS[unit]
        self.turning[name] = unit in ANGLE_UNITS
        if (name, TWICE[0]) in nodes:
            self.twice[name] = TwoMeasurements(rotary=unit in ANGLE_UNITS)
        else:
            self.once[name] = OneMeasurement(rotary=unit in ANGLE_UNITS)
        return nodes

    async def _split(self, name: str, item: str, nodes: dict[Key, Node]) -> str | None:
        """Take a structure's fields where they are variables below it; tell the unit.

        They come with units, and one by one.
        """
        position = nodes[name, item]
        actual, commanded = await child(position, "ActPos"), await child(position, "CmdPos")
        if actual is not None:
            nodes[name, item] = actual
            if commanded is not None:
                nodes.setdefault((name, COMMANDED[item]), commanded)
        return await _unit(nodes[name, item]) or await _unit(position)

    async def _channel_nodes(self) -> dict[Key, Node]:
        found: dict[Key, Node | None] = {}
        if self._mapping.axes:
            for item, path in self._mapping.channel.items():
                found["", item] = await self.addresses.variable(path, f"{item} of the channel")
        else:
            interface = await self._interface()
            if channel := await _first(interface, "CncChannelList"):
                for item, name in _CHANNEL_NAMES.items():
                    found["", item] = await child(channel, name)
            if spindle := await _first(interface, "CncSpindleList"):
                found["", "spindle_angle"] = await child(spindle, "AnglePos")
        nodes = {key: node for key, node in found.items() if node is not None}
        angle = nodes.get(("", "spindle_angle"))
        if angle is not None:
            actual = await child(angle, "ActPos") or angle
            nodes["", "spindle_angle"] = actual
            unit = await _unit(actual) or await _unit(angle) or "deg"
            # Of a unit that is none the angle is not known, which stops no pose.
            self.per_angle = UNITS[unit] if unit in ANGLE_UNITS else math.nan
        return nodes


def _refuse_shared(nodes: dict[Key, Node]) -> None:
    """Raise InputError where two axes would have one position: a slip of the pen."""
    owners: dict[ua.NodeId, str] = {}
    for (axis, item), node in nodes.items():
        other = owners.setdefault(node.nodeid, axis) if item in POSITIONS else axis
        if other != axis:
            raise InputError(
                f"OPC UA: expected a node of its own as the position of each axis, got"
                f" {node.nodeid.to_string()} for {other} and {axis}."
            )


def _without_unitless(
    name: str, units: dict[str, str | None], nodes: dict[Key, Node]
) -> dict[str, str | None]:
    """Leave out positions that exist by type only: without a unit, beside another."""
    kept = {item: unit for item, unit in units.items() if unit is not None}
    for item in units.keys() - kept.keys():
        for key in (item, COMMANDED[item]):
            nodes.pop((name, key), None)
    if len(kept) > 1:
        return dict(kept)
    ((only, unit),) = kept.items()
    for key, plain in ((only, "position"), (COMMANDED[only], "commanded")):
        if (name, key) in nodes:
            nodes[name, plain] = nodes.pop((name, key))
    return {"position": unit}


async def _bool(node: Node) -> bool | None:
    """Return a node's yes or no; None where it says neither."""
    try:
        value = await node.read_value()
    except ua.UaError:
        return None
    return value if isinstance(value, bool) else None


async def _says_true(node: Node | None) -> bool:
    return node is not None and await _bool(node) is True


def _unit_trouble(units: set[str | None], turns: bool | None) -> str:
    """Return why units give no scale; empty where they do."""
    if None in units:
        return "tells no unit; give it in the mapping file"
    if unknown := sorted(str(unit) for unit in units if unit not in UNITS):
        return (
            f"is told in {', '.join(unknown):.80}, which is none of {', '.join(UNITS)}; give the"
            " unit in the mapping file"
        )
    if len(units) > 1:
        return f"has positions in {' and '.join(sorted(str(u) for u in units))}"
    unit = next(iter(units))
    if turns is not None and turns != (unit in ANGLE_UNITS):
        return f"{'turns' if turns else 'does not turn'} but is told in {unit}"
    return ""


async def _first(interface: Node, name: str) -> Node | None:
    """Return the first object of a list of the interface."""
    found = await child(interface, name)
    objects = await found.get_children(nodeclassmask=ua.NodeClass.Object) if found else []
    return objects[0] if objects else None


async def _unit(node: Node) -> str | None:
    """Return the unit in a variable's EngineeringUnits: by UNECE's code, or in words.

    One that is not known, or whose code and words contradict each other, comes as it is.
    """
    units = await child(node, "EngineeringUnits")
    if units is None:
        return None
    try:
        value = await units.read_value()
    except ua.UaError:  # of an axis that is none, often
        return None
    if not isinstance(value, ua.EUInformation):
        return None
    code = "".join(chr((value.UnitId >> shift) & 0xFF) for shift in (16, 8, 0)).strip("\0")
    text = (value.DisplayName.Text or "").strip()
    known = {_UNIT_CODES.get(code), _UNIT_WORDS.get(text.lower())} - {None}
    if len(known) == 1:
        return known.pop()
    return f"{code} ({text})" if known else text or None
