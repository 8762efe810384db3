"""One connection to an OPC UA server: finds the nodes, subscribes, makes samples of what comes.

A server reports a value when it changes. An axis at rest is therefore silent, which must not look
like a lost one: its source timestamp is subscribed too (a control that refreshes it proves that it
was read), and the server's own clock, which always moves, ends every group of values.
"""

from __future__ import annotations

import asyncio
import calendar
import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from asyncua import Client, Node, ua

from omm_cnc_bridge.clock import ControlClock, ros_from_monotonic_ns
from omm_cnc_bridge.control import ControlSample, Mode, ProgramState, WorkOffset
from omm_cnc_bridge.controls.opcua import offsets
from omm_cnc_bridge.controls.opcua.logging_in import Security, log_in
from omm_cnc_bridge.controls.opcua.mapping import (
    ANGLE_UNITS,
    TWICE,
    UNITS,
    AxisItems,
    Mapping40502,
)
from omm_cnc_bridge.controls.opcua.two_measurements import AxisReading, Choice, TwoMeasurements
from omm_core.errors import DeviceError, InputError

QUEUE = 20
GATHER_S = 0.002
_UNIT_CODES = {"MMT": "mm", "MTR": "m", "INH": "inch", "C81": "rad", "DD": "deg"}
_UNIT_WORDS = {
    "mm": "mm",
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
_POSITIONS = ("position", *TWICE)
_POSITIONS_PROOF = ("referenced", "status")
_COMMANDED = {"position": "commanded", **{item: f"{item} commanded" for item in TWICE}}
_Key = tuple[str, str]  # axis and item, or "" and an item of the channel


class Session:
    """See the module; all methods run in the client's event loop."""

    def __init__(
        self,
        url: str,
        mapping: Mapping40502,
        security: Security,
        *,
        interval_s: float,
        clock: ControlClock,
        put: Callable[[ControlSample | DeviceError], None],
    ) -> None:
        self._url = url
        self._notes: tuple[str, ...] = ()
        self._client = Client(url, timeout=4.0, watchdog_intervall=2.0)
        self._mapping, self._security = mapping, security
        self._interval_s = self.revised_interval_s = interval_s
        self._clock, self._put = clock, put
        self._keys: dict[ua.NodeId, _Key] = {}
        self._scales: dict[str, float] = {}
        self._rest_values: dict[str, int] = {}
        self._unusable: dict[str, str] = {}
        self._twice: dict[str, TwoMeasurements] = {}
        self._chosen: dict[str, Choice] = {}
        self._per_angle = UNITS["deg"]
        self._values: dict[_Key, Any] = {}
        self._bad: dict[_Key, str] = {}
        self._gathered: list[tuple[int, _Key, ua.DataValue]] = []
        self._received_ns = 0
        self._last_ns = 0
        self._refreshes = False
        self._steps_ns: deque[int] = deque(maxlen=21)
        self._acknowledge: Node | None = None
        self._offsets: dict[str, dict[str, Node]] = {}
        self.correction_nodes: dict[str, Node] = {}

    async def open(self) -> None:
        """Connect, find the nodes, subscribe."""
        self._notes = await log_in(self._client, self._url, self._security)
        await self._client.load_data_type_definitions()
        self._client.connection_lost_callback = self._on_lost
        axes = dict(self._mapping.axes) or await self._browse_axes()
        nodes: dict[_Key, Node] = {}
        for name, items in axes.items():
            nodes |= await self._axis_nodes(name, items)
        if not self._scales:
            reasons = "; ".join(f"axis {axis} {why}" for axis, why in self._unusable.items())
            raise InputError(f"OPC UA: expected axes that can be used: {reasons or 'none are'}.")
        nodes |= await self._channel_nodes()
        nodes["", "clock"] = self._client.get_node(ua.ObjectIds.Server_ServerStatus_CurrentTime)
        self._keys = {node.nodeid: key for key, node in nodes.items()}
        if self._mapping.acknowledge:
            self._acknowledge = await self._find(self._mapping.acknowledge)
        for name, offset in self._mapping.offsets.items():
            self._offsets[name] = {i: await self._find(p) for i, p in offset.paths.items()}
        if (correction := self._mapping.correction) is not None:
            self.correction_nodes = {i: await self._find(p) for i, p in correction.paths.items()}
        await self._subscribe(nodes)

    async def close(self) -> None:
        """Disconnect, without reporting that as a loss."""
        self._client.connection_lost_callback = None
        await self._client.disconnect()

    async def acknowledge(self, request: int) -> None:
        """Write the number of an image, in the type that the node has."""
        assert self._acknowledge is not None
        variant = await self._acknowledge.read_data_type_as_variant_type()
        await self._acknowledge.write_value(ua.DataValue(ua.Variant(request, variant)))

    async def work_offset(self, name: str, wanted: WorkOffset | None) -> WorkOffset:
        """Return a work offset, after writing it where one is given."""
        nodes, mapped = self._offsets[name], self._mapping.offsets[name]
        if wanted is not None:
            await offsets.write(nodes, offsets.values_of(wanted, mapped))
        return offsets.offset_of(name, await offsets.read(nodes), mapped)

    # --- connecting ----------------------------------------------------------------------------

    async def _on_lost(self, error: Exception) -> None:
        self._put(DeviceError(f"OPC UA: the connection is lost ({error!r})."))

    async def _subscribe(self, nodes: dict[_Key, Node]) -> None:
        interval_ms = self._interval_s * 1e3
        subscription = await self._client.create_subscription(interval_ms, self)
        stamps_too = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)
        asked_ms = await self._interval_to_ask_for(subscription, nodes)
        for key, node in nodes.items():
            await subscription._subscribe(
                node,
                mfilter=None if key == ("", "clock") else stamps_too,
                queuesize=QUEUE,
                sampling_interval=asked_ms,
            )

    async def _interval_to_ask_for(self, subscription: Any, nodes: dict[_Key, Node]) -> float:
        """Return our interval (ms); 0 where the server revises ours upwards but 0 less.

        Such a server samples by slow timers, or reports every change (OPC 10000-4, 5.12.1.2).
        Others could flood us when asked for 0.
        """
        interval_ms = self._interval_s * 1e3
        trial = next(node for (_, item), node in nodes.items() if item in _POSITIONS)
        items = [
            subscription._make_monitored_item_request(
                trial, ua.AttributeIds.Value, None, 1, ua.MonitoringMode.Disabled, asked_ms
            )
            for asked_ms in (interval_ms, 0.0)
        ]
        made = await subscription.server.create_monitored_items(
            ua.CreateMonitoredItemsParameters(
                SubscriptionId=subscription.subscription_id, ItemsToCreate=items
            )
        )
        await subscription.server.delete_monitored_items(
            ua.DeleteMonitoredItemsParameters(
                SubscriptionId=subscription.subscription_id,
                MonitoredItemIds=[item.MonitoredItemId for item in made],
            )
        )
        revised_ms = [item.RevisedSamplingInterval for item in made]
        ours_ms, fastest_ms = revised_ms
        return 0.0 if ours_ms > 1.5 * interval_ms and fastest_ms < ours_ms else interval_ms

    # --- finding nodes -------------------------------------------------------------------------

    async def _find(self, path: str, start: Node | None = None) -> Node:
        """Return the node of a path or node id; raise InputError where there is none."""
        if "=" in path.split("/", 1)[0]:
            return await self._by_id(path)
        node = start or self._client.nodes.objects
        for name in path.split("/"):
            found = await _child(node, name)
            if found is None:
                names = [(await c.read_browse_name()).Name for c in await node.get_children()]
                raise InputError(
                    f"OPC UA: expected {name} of the path {path}, the server has {names} there."
                )
            node = found
        return node

    async def _by_id(self, text: str) -> Node:
        if text.startswith("nsu="):
            uri, rest = text[4:].split(";", 1)
            text = f"ns={await self._client.get_namespace_index(uri)};{rest}"
        return self._client.get_node(text)

    async def _interface(self) -> Node:
        """Return the server's CncInterface that has axes, at most three levels below Objects.

        OPC 40502's own nodeset brings an interface without any ("test") along.
        """
        level = [self._client.nodes.objects]
        for _ in range(3):
            below: list[Node] = []
            for node in level:
                axes = await _child(node, "CncAxisList")
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
        axis_list = await self._find("CncAxisList", await self._interface())
        axes = {}
        for axis in await axis_list.get_children(nodeclassmask=ua.NodeClass.Object):
            paths = {}
            for item, name in _AXIS_NAMES.items():
                node = await _child(axis, name)
                if node is not None:
                    paths[item] = node.nodeid.to_string()
            positions = [item for item in TWICE if item in paths]
            if len(positions) == 1:
                paths["position"] = paths.pop(positions[0])
            if positions:
                axes[(await axis.read_browse_name()).Name] = AxisItems(paths=paths)
        if not axes:
            raise InputError("OPC UA: expected axes in the CncAxisList, it is empty.")
        return axes

    async def _axis_nodes(self, name: str, items: AxisItems) -> dict[_Key, Node]:
        nodes = {(name, item): await self._find(path) for item, path in items.paths.items()}
        self._rest_values[name] = items.in_position
        if await _says_true(nodes.pop((name, "virtual"), None)):
            return {}
        rotational = nodes.pop((name, "rotational"), None)
        turns = await _bool(rotational) if rotational is not None else None
        units: dict[str, str | None] = {}
        for item in _POSITIONS:
            if (name, item) in nodes:
                units[item] = await self._split(name, item, nodes)
        if items.unit:
            units = dict.fromkeys(units, items.unit)
        elif len(units) > 1 and any(units.values()):
            units = _without_unitless(name, units, nodes)
        trouble = _unit_trouble(set(units.values()), turns)
        if trouble:
            self._unusable[name] = trouble
            inactive = nodes.get((name, "inactive"))
            return {} if inactive is None else {(name, "inactive"): inactive}
        unit = str(next(iter(units.values())))
        self._scales[name] = UNITS[unit]
        if (name, TWICE[0]) in nodes:
            self._twice[name] = TwoMeasurements(rotary=unit in ANGLE_UNITS)
        return nodes

    async def _split(self, name: str, item: str, nodes: dict[_Key, Node]) -> str | None:
        """Take a structure's fields where they are variables below it; tell the unit.

        They come with units, and one by one.
        """
        position = nodes[name, item]
        actual, commanded = await _child(position, "ActPos"), await _child(position, "CmdPos")
        if actual is not None:
            nodes[name, item] = actual
            if commanded is not None:
                nodes.setdefault((name, _COMMANDED[item]), commanded)
        return await _unit(nodes[name, item]) or await _unit(position)

    async def _channel_nodes(self) -> dict[_Key, Node]:
        found: dict[_Key, Node | None] = {}
        if self._mapping.axes:
            for item, path in self._mapping.channel.items():
                found["", item] = await self._find(path)
        else:
            interface = await self._interface()
            if channel := await _first(interface, "CncChannelList"):
                for item, name in _CHANNEL_NAMES.items():
                    found["", item] = await _child(channel, name)
            if spindle := await _first(interface, "CncSpindleList"):
                found["", "spindle_angle"] = await _child(spindle, "AnglePos")
        nodes = {key: node for key, node in found.items() if node is not None}
        angle = nodes.get(("", "spindle_angle"))
        if angle is not None:
            actual = await _child(angle, "ActPos") or angle
            nodes["", "spindle_angle"] = actual
            self._per_angle = UNITS[await _unit(actual) or await _unit(angle) or "deg"]
        return nodes

    # --- what comes ----------------------------------------------------------------------------

    def datachange_notification(self, node: Node, value: object, data: Any) -> None:
        """Gather the values of one publishing; they come one by one, without an end mark."""
        del value
        now_ns = time.monotonic_ns()
        if not self._gathered:
            self._received_ns = now_ns
            asyncio.get_running_loop().call_later(GATHER_S, self._make_samples)
        item = data.monitored_item.Value
        stamp = item.SourceTimestamp or item.ServerTimestamp
        if stamp is not None:
            self._gathered.append((_ns(stamp), self._keys[node.nodeid], item))

    def status_change_notification(self, status: Any) -> None:
        """Report that the server ends the subscription (called by asyncua)."""
        self._put(DeviceError(f"OPC UA: the server ends the subscription ({status.Status})."))

    def _make_samples(self) -> None:
        """Make one sample of each group of equal stamps, oldest first."""
        gathered, self._gathered = sorted(self._gathered, key=lambda g: g[0]), []
        # Program and mode keep the stamp of their last change; they only accompany positions.
        slow = [g for g in gathered if g[1][0] == "" and g[1][1] != "clock"]
        for _, key, item in slow:
            self._set(key, item)
        moving = [g for g in gathered if g not in slow]
        together_ns = round(0.3e9 * self.revised_interval_s)
        while moving:
            end_ns = moving[0][0] + together_ns
            group = [g for g in moving if g[0] <= end_ns]
            moving = moving[len(group) :]
            before = self._positions()[0]
            for _, key, item in group:
                self._set(key, item)
            stamps = [stamp for stamp, key, _ in group if key[1] in _POSITIONS]
            if stamps:
                self._refreshes |= before == self._positions()[0]
                self._learn_interval(max(stamps))
                self._emit(max(stamps), fresh=True)
            else:
                self._at_rest(group[-1][0])

    def _learn_interval(self, stamp_ns: int) -> None:
        """Learn the interval that the server really keeps: it may have revised ours upwards."""
        self._steps_ns.append(stamp_ns - self._last_ns)
        self._last_ns = stamp_ns
        if len(self._steps_ns) == self._steps_ns.maxlen:
            typical_ns = sorted(self._steps_ns)[len(self._steps_ns) // 2]
            self.revised_interval_s = max(self._interval_s, min(1.0, typical_ns / 1e9))

    def _at_rest(self, clock_ns: int) -> None:
        """Make a sample at rest: the server's clock went on and reported no axis.

        Unless this server has refreshed the stamps of axes at rest before: then its silence means
        that the control behind it is not heard any more.
        """
        if self._refreshes:
            return
        interval_ns = round(1e9 * self.revised_interval_s)
        stamp_ns = clock_ns - interval_ns
        if self._last_ns and stamp_ns - self._last_ns > interval_ns // 2:
            self._last_ns = stamp_ns
            self._emit(stamp_ns, fresh=False)

    def _set(self, key: _Key, item: ua.DataValue) -> None:
        if item.StatusCode is not None and not item.StatusCode.is_good():
            self._bad[key] = item.StatusCode.name
        else:
            self._bad.pop(key, None)
        self._values[key] = item.Value.Value if item.Value is not None else None

    def _emit(self, control_ns: int, *, fresh: bool) -> None:
        positions, commanded = self._positions()
        if not self._all_came():
            return  # the first values are still on their way
        unusable = self._unusable_now(positions)
        ours_ns, clock_ns = self._clock.observe(control_ns, self._received_ns)
        # Known to be unchanged by the server's clock only: sampled within one interval.
        spread_ns = 0.0 if fresh else 0.5e9 * self.revised_interval_s
        v, m = self._values, self._mapping
        request = v.get(("", "measure_request"))
        self._put(
            ControlSample(
                stamp_ns=ros_from_monotonic_ns(ours_ns),
                stamp_uncertainty_ns=round(math.hypot(clock_ns, spread_ns)),
                positions=positions,
                unusable=unusable,
                notes=self._notes
                + tuple(
                    f"axis {axis}: {choice.name} is used, {choice.why}"
                    for axis, choice in self._chosen.items()
                    if choice.name
                ),
                commanded=commanded,
                in_position=self._in_position(),
                fault=self._fault(),
                mode=Mode[m.modes.get(v.get(("", "mode"), -1), "UNKNOWN")],
                program_state=ProgramState[
                    m.program_states.get(v.get(("", "program_status"), -1), "UNKNOWN")
                ],
                program=str(v.get(("", "program")) or ""),
                program_line=_line(v.get(("", "program_line"))),
                measure_request=int(request) if request else None,
                spindle_angle_rad=self._spindle_angle_rad(),
            )
        )

    def _positions(self) -> tuple[dict[str, float], dict[str, float]]:
        """Return measured and commanded positions, mm and rad."""
        measured, commanded = {}, {}
        for axis in self._scales:
            if self._is_inactive(axis):
                continue
            reading = self._reading(axis, "position")
            if axis in self._twice:
                both = {item: self._reading(axis, item) for item in TWICE}
                choice = self._twice[axis].choose(*both.values())
                self._chosen[axis] = choice
                reading = both.get(choice.name, AxisReading(actual=None, why_not=choice.why))
            if reading.actual is None:
                continue
            measured[axis] = reading.actual
            if reading.commanded is not None:
                commanded[axis] = reading.commanded
        return measured, commanded

    def _reading(self, axis: str, item: str) -> AxisReading:
        scale = self._scales[axis]
        value: Any = self._values.get((axis, item))
        wanted: Any = self._values.get((axis, _COMMANDED[item]))
        if hasattr(value, "ActPos"):
            value, wanted = value.ActPos, value.CmdPos
        actual, commanded = _number(value), _number(wanted)
        why = self._bad.get((axis, item), "")
        if not why and actual is None:
            why = f"{value!r} is no number"
        return AxisReading(
            actual=None if actual is None or why else actual * scale,
            commanded=None if commanded is None else commanded * scale,
            why_not=why,
        )

    def _is_inactive(self, axis: str) -> bool:
        return self._values.get((axis, "inactive")) is True

    def _all_came(self) -> bool:
        """Return whether every node of a position has been heard of once, good or bad."""
        wanted = {key for key in self._keys.values() if key[1] in _POSITIONS}
        return wanted <= self._values.keys()

    def _unusable_now(self, positions: dict[str, float]) -> dict[str, str]:
        """Return why axes have no position now; inactive axes are left out."""
        unusable = {a: why for a, why in self._unusable.items() if not self._is_inactive(a)}
        for axis in self._scales:
            if axis in positions or self._is_inactive(axis):
                continue
            choice = self._chosen.get(axis)
            unusable[axis] = choice.why if choice else self._reading(axis, "position").why_not
        lost = [a for (a, item), v in self._values.items() if item == "referenced" and v is False]
        for axis in lost:
            if axis in positions:
                unusable[axis] = "is not referenced"
        for (axis, item), why in self._bad.items():
            if axis in positions and item in _POSITIONS_PROOF:
                unusable[axis] = f"{item} is {why}"
        return unusable

    def _spindle_angle_rad(self) -> float:
        value = self._values.get(("", "spindle_angle"))
        angle = _number(getattr(value, "ActPos", value))
        return math.nan if angle is None else angle * self._per_angle

    def _in_position(self) -> bool | None:
        states = [
            value == self._rest_values[axis]
            for (axis, item), value in self._values.items()
            if item == "status" and axis in self._scales and not self._is_inactive(axis)
        ]
        return all(states) if states else None

    def _fault(self) -> str | None:
        bad = [f"channel {item}: {why}" for (a, item), why in self._bad.items() if not a]
        return "; ".join(bad) or None


async def _child(node: Node, name: str) -> Node | None:
    """Return a child by its browse name; a name without ``ns:`` fits any namespace."""
    wanted = ua.QualifiedName.from_string(name) if ":" in name else None
    for reference in await node.get_references(direction=ua.BrowseDirection.Forward):
        browse_name = reference.BrowseName
        if browse_name == wanted or (wanted is None and browse_name.Name == name):
            return Node(node.session, reference.NodeId)
    return None


def _without_unitless(
    name: str, units: dict[str, str | None], nodes: dict[_Key, Node]
) -> dict[str, str | None]:
    """Leave out positions that exist by type only: without a unit, beside another."""
    kept = {item: unit for item, unit in units.items() if unit is not None}
    for item in units.keys() - kept.keys():
        for key in (item, _COMMANDED[item]):
            nodes.pop((name, key), None)
    if len(kept) > 1:
        return dict(kept)
    ((only, unit),) = kept.items()
    for key, plain in ((only, "position"), (_COMMANDED[only], "commanded")):
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
    if len(units) > 1:
        return f"has positions in {' and '.join(sorted(str(u) for u in units))}"
    unit = next(iter(units))
    if turns is not None and turns != (unit in ANGLE_UNITS):
        return f"{'turns' if turns else 'does not turn'} but is told in {unit}"
    return ""


async def _first(interface: Node, name: str) -> Node | None:
    """Return the first object of a list of the interface."""
    found = await _child(interface, name)
    objects = await found.get_children(nodeclassmask=ua.NodeClass.Object) if found else []
    return objects[0] if objects else None


async def _unit(node: Node) -> str | None:
    """Return the unit in a variable's EngineeringUnits: by UNECE's code, or in words."""
    units = await _child(node, "EngineeringUnits")
    if units is None:
        return None
    try:
        value = await units.read_value()
    except ua.UaError:  # of an axis that is none, often
        return None
    if not isinstance(value, ua.EUInformation):
        return None
    code = "".join(chr((value.UnitId >> shift) & 0xFF) for shift in (16, 8, 0)).strip("\0")
    return _UNIT_CODES.get(code) or _UNIT_WORDS.get((value.DisplayName.Text or "").strip().lower())


def _ns(stamp: Any) -> int:
    """Return a timestamp as nanoseconds since the epoch, without the rounding of floats."""
    return calendar.timegm(stamp.timetuple()) * 1_000_000_000 + stamp.microsecond * 1000


def _number(value: object) -> float | None:
    """Return a finite number; None for anything else that a server may hold."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) else None  # type: ignore[arg-type]


def _line(value: object) -> int:
    return int(value) if isinstance(value, int | float) else -1
