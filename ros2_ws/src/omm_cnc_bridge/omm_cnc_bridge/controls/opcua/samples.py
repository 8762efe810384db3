"""Make samples of the values that an OPC UA server reports.

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
from collections.abc import Callable, Mapping
from typing import Any

from asyncua import Node, ua

from omm_cnc_bridge.clock import ControlClock, ros_from_monotonic_ns
from omm_cnc_bridge.control import ControlSample, Mode, ProgramState
from omm_cnc_bridge.controls.opcua.mapping import TWICE, Mapping40502
from omm_cnc_bridge.controls.opcua.nodes import COMMANDED, POSITIONS, Key, NodeFinder
from omm_cnc_bridge.controls.opcua.two_measurements import AxisReading, Choice
from omm_core.errors import DeviceError

GATHER_S = 0.002
_PROOF = ("referenced", "status")


class SampleMaker:
    """Receives what a subscription reports (asyncua's handler), and puts samples.

    Parameters
    ----------
    found : NodeFinder
        How values are read.
    keys : mapping
        Axis and item of each node that is subscribed.
    notes : tuple of str
        What every sample tells of the connection.
    put : function
        Takes samples, and what went wrong.
    """

    def __init__(
        self,
        found: NodeFinder,
        mapping: Mapping40502,
        keys: Mapping[ua.NodeId, Key],
        *,
        notes: tuple[str, ...],
        interval_s: float,
        clock: ControlClock,
        put: Callable[[ControlSample | DeviceError], None],
    ) -> None:
        self._found, self._mapping, self._keys, self._notes = found, mapping, keys, notes
        self._interval_s = self.revised_interval_s = interval_s
        self._clock, self._put = clock, put
        self._chosen: dict[str, Choice] = {}
        self._values: dict[Key, Any] = {}
        self._bad: dict[Key, str] = {}
        self._gathered: list[tuple[int, Key, ua.DataValue]] = []
        self._received_ns = 0
        self._last_ns = 0
        self._refreshes = False
        self._steps_ns: deque[int] = deque(maxlen=21)

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
            stamps = [stamp for stamp, key, _ in group if key[1] in POSITIONS]
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

    def _set(self, key: Key, item: ua.DataValue) -> None:
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
                turning=self._found.turning,
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
        for axis in self._found.scales:
            if self._is_inactive(axis):
                continue
            reading = self._reading(axis, "position")
            if axis in self._found.twice:
                both = {item: self._reading(axis, item) for item in TWICE}
                choice = self._found.twice[axis].choose(*both.values())
                self._chosen[axis] = choice
                reading = both.get(choice.name, AxisReading(actual=None, why_not=choice.why))
            elif why := self._found.once[axis].refusal(reading):
                self._chosen[axis] = Choice(name="", why=why)
                continue
            else:
                self._chosen.pop(axis, None)
            if reading.actual is None:
                continue
            measured[axis] = reading.actual
            if reading.commanded is not None:
                commanded[axis] = reading.commanded
        return measured, commanded

    def _reading(self, axis: str, item: str) -> AxisReading:
        scale = self._found.scales[axis]
        value: Any = self._values.get((axis, item))
        wanted: Any = self._values.get((axis, COMMANDED[item]))
        if hasattr(value, "ActPos"):
            value, wanted = value.ActPos, value.CmdPos
        actual, commanded = _number(value), _number(wanted)
        why = self._bad.get((axis, item), "")
        if not why and actual is None:
            why = f"{value!r:.80} is not a number"
        return AxisReading(
            actual=None if actual is None or why else actual * scale,
            commanded=None if commanded is None else commanded * scale,
            why_not=why,
        )

    def _is_inactive(self, axis: str) -> bool:
        return self._values.get((axis, "inactive")) is True

    def _all_came(self) -> bool:
        """Return whether every node of a position has been heard of once, good or bad."""
        wanted = {key for key in self._keys.values() if key[1] in POSITIONS}
        return wanted <= self._values.keys()

    def _unusable_now(self, positions: dict[str, float]) -> dict[str, str]:
        """Return why axes have no position now; inactive axes are left out."""
        unusable = {a: why for a, why in self._found.unusable.items() if not self._is_inactive(a)}
        for axis in self._found.scales:
            if axis in positions or self._is_inactive(axis):
                continue
            choice = self._chosen.get(axis)
            unusable[axis] = choice.why if choice else self._reading(axis, "position").why_not
        for (axis, item), value in self._values.items():
            # Anything but a yes is a no: controls say it as a number, too.
            if item == "referenced" and axis in positions and not _is_yes(value):
                unusable[axis] = f"is not referenced (expected true or 1, got {value!r:.80})"
        for (axis, item), why in self._bad.items():
            if axis in positions and item in _PROOF:
                unusable[axis] = f"{item} is {why}"
        return unusable

    def _spindle_angle_rad(self) -> float:
        value = self._values.get(("", "spindle_angle"))
        angle = _number(getattr(value, "ActPos", value))
        return math.nan if angle is None else angle * self._found.per_angle

    def _in_position(self) -> bool | None:
        states = [
            value == self._found.rest_values[axis]
            for (axis, item), value in self._values.items()
            if item == "status" and axis in self._found.scales and not self._is_inactive(axis)
        ]
        return all(states) if states else None

    def _fault(self) -> str | None:
        bad = [f"channel {item}: {why}" for (a, item), why in self._bad.items() if not a]
        return "; ".join(bad) or None


def _ns(stamp: Any) -> int:
    """Return a timestamp as nanoseconds since the epoch, without the rounding of floats."""
    return calendar.timegm(stamp.timetuple()) * 1_000_000_000 + stamp.microsecond * 1000


def _is_yes(value: object) -> bool:
    return isinstance(value, (bool, int)) and value == 1


def _number(value: object) -> float | None:
    """Return a finite number; None for anything else that a server may hold."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) else None  # type: ignore[arg-type]


def _line(value: object) -> int:
    return int(value) if isinstance(value, int | float) else -1
