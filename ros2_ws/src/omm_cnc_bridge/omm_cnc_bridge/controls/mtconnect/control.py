"""Controls that are heard through an MTConnect agent (1.3 to 2.x). It can only be listened to.

An agent reports what changes. While nothing does it sends empty documents (heartbeats); the axes
have then stood still, which is known to one interval only, and the sample's uncertainty says so.
Whether the control behind the agent is still there, the agent tells by UNAVAILABLE.
"""

from __future__ import annotations

import contextlib
import http.client
import math
import socket
from collections.abc import Sequence
from urllib.parse import SplitResult, quote, urlsplit

from omm_cnc_bridge.clock import ControlClock, ros_from_monotonic_ns
from omm_cnc_bridge.control import ControlSample, Mode, ProgramState
from omm_cnc_bridge.controls.mtconnect.meaning import Device, Item
from omm_cnc_bridge.controls.mtconnect.model import (
    Document,
    Observation,
    read_device,
    read_document,
)
from omm_cnc_bridge.controls.mtconnect.multipart import SILENCE_S, MultipartReader, whole_answer
from omm_cnc_bridge.controls.mtconnect.texts import POINT, line, number, unseen, why_not
from omm_core.errors import DeviceError, InputError

HEARTBEAT_MS = 20
COUNT = 1000
ATTEMPTS = (
    5  # an agent with a small buffer may have dropped what we ask for by the time it hears it
)
UNAVAILABLE = "UNAVAILABLE"
TOOL_POINT_ONLY = (
    "the agent tells the tool point (PATH_POSITION) and no axes; it is off by the tool's length"
    " unless the control has none active, or 'reported' and 'tool_length_mm' say so"
)
TOOL_POINT_BESIDE_AXES = (
    "only the tool point (PATH_POSITION) tells of it, which is not where the axis is;"
    " set reported:=tool_point and tool_length_mm"
)
_MODES = {
    "AUTOMATIC": Mode.AUTOMATIC,
    "MANUAL": Mode.MANUAL,
    "MANUAL_DATA_INPUT": Mode.MDI,
    "SEMI_AUTOMATIC": Mode.AUTOMATIC,
}
_PROGRAM_STATES = {
    "ACTIVE": ProgramState.RUNNING,
    "READY": ProgramState.STOPPED,
    "STOPPED": ProgramState.STOPPED,
    "INTERRUPTED": ProgramState.INTERRUPTED,
    "FEED_HOLD": ProgramState.INTERRUPTED,
    "OPTIONAL_STOP": ProgramState.INTERRUPTED,
    "PROGRAM_STOPPED": ProgramState.INTERRUPTED,
    "WAIT": ProgramState.WAITING,
    "PROGRAM_COMPLETED": ProgramState.FINISHED,
}


class MtConnectControl:
    """The agent at ``url``.

    Parameters
    ----------
    device : str
        Needed where the agent has several.
    tool_point : bool
        Whether X, Y, Z are wanted of the tool point (PATH_POSITION), where the agent has it.
    """

    name = "mtconnect"

    def __init__(
        self, url: str, *, rate_hz: float, device: str = "", tool_point: bool = False
    ) -> None:
        self.clock = ControlClock()
        self._tool_point = tool_point
        self._url, self._device = _address(url), device
        self._interval_ms = max(1, round(1e3 / rate_hz))
        self._connection: http.client.HTTPConnection | None = None
        self._parts: MultipartReader | None = None
        self._described = Device(items={})
        self._texts: dict[str, str] = {}
        self._instance = ""
        self._next = 0

    def connect(self) -> None:
        """Read what the agent describes, and start its stream."""
        self.close()
        self.clock = ControlClock()
        try:
            self._described = self._read_model()
            self._resynchronise(ATTEMPTS)
        except (OSError, http.client.HTTPException) as error:
            raise DeviceError(f"MTConnect agent {self._url.geturl()}: {error}.") from error

    def _read_model(self) -> Device:
        """Return the agent's model; one that fits no longer may fit again when it is restarted."""
        try:
            return read_device(self._get("/probe"), self._device)
        except InputError as error:
            if not self._instance:  # never heard: what is asked for is wrong
                raise
            raise DeviceError(f"{error} The agent has another model than before.") from error

    def read(self, timeout_s: float) -> Sequence[ControlSample]:
        """Return the samples in what the agent has sent, oldest first."""
        if self._parts is None:
            raise DeviceError("MTConnect: not connected.")
        parts = self._parts.read(timeout_s)
        samples: list[ControlSample] = []
        for received_ns, part in parts:
            samples += self._take(read_document(part), received_ns)
        return samples

    def acknowledge(self, request: int) -> None:
        """Refuse: MTConnect can only be read."""
        raise DeviceError(f"MTConnect cannot answer (image {request}): agents only report.")

    def close(self) -> None:
        """Close the connection, which ends the reading thread."""
        self._parts = None
        connection, self._connection = self._connection, None
        if connection is not None:
            if connection.sock is not None:
                with contextlib.suppress(OSError):  # the agent may have closed it already
                    connection.sock.shutdown(socket.SHUT_RDWR)  # ends the reading thread
            connection.close()

    # --- the agent -----------------------------------------------------------------------------

    def _open(self, path: str) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
        host, port = str(self._url.hostname), self._url.port
        secure = self._url.scheme == "https"
        kind = http.client.HTTPSConnection if secure else http.client.HTTPConnection
        connection = kind(host, port, timeout=SILENCE_S)
        device = f"/{quote(self._device)}" if self._device else ""
        connection.request("GET", self._url.path.rstrip("/") + device + path)
        return connection, connection.getresponse()

    def _get(self, path: str) -> bytes:
        connection, response = self._open(path)
        with contextlib.closing(connection), response:
            return whole_answer(response)

    def _resynchronise(self, attempts: int) -> None:
        """Take the present values, then everything that comes after them."""
        current = read_document(self._get("/current"))
        self._instance, self._next = current.instance_id, current.next_sequence
        self._texts = {o.item_id: o.text for o in current.observations}
        # An agent refuses to be asked for more than it keeps.
        count = max(1, min(COUNT, current.buffer_size - 1)) if current.buffer_size else COUNT
        query = f"interval={self._interval_ms}&heartbeat={HEARTBEAT_MS}&count={count}"
        self._connection, response = self._open(f"/sample?from={self._next}&{query}")
        try:
            self._parts = MultipartReader(response)
        except DeviceError as error:
            self.close()
            if attempts <= 1 or "OUT_OF_RANGE" not in str(error):
                raise
            self._resynchronise(attempts - 1)

    # --- samples -------------------------------------------------------------------------------

    def _take(self, document: Document, received_ns: int) -> list[ControlSample]:
        if document.instance_id != self._instance:
            raise DeviceError("MTConnect: the agent was restarted.")
        if document.first_sequence > self._next:
            raise DeviceError("MTConnect: the agent's buffer overflowed; what it held is lost.")
        news = [o for o in document.observations if o.sequence >= self._next]
        self._next = max(self._next, document.next_sequence)
        if not news:
            return self._at_rest(received_ns)
        samples = []
        for i, observation in enumerate(news):
            self._texts[observation.item_id] = observation.text
            last_of_stamp = i + 1 == len(news) or news[i + 1].stamp_ns > observation.stamp_ns
            if last_of_stamp and self._is_position(news, observation.stamp_ns):
                ours_ns, sigma_ns = self.clock.observe(observation.stamp_ns, received_ns)
                samples.append(self._sample(ours_ns, sigma_ns))
        return samples

    def _is_position(self, news: list[Observation], stamp_ns: int) -> bool:
        roles = {
            self._described.items[o.item_id].role
            for o in news
            if o.stamp_ns == stamp_ns and o.item_id in self._described.items
        }
        return bool(roles & {"measured", "path"})

    def _at_rest(self, received_ns: int) -> list[ControlSample]:
        """Return the sample of a heartbeat: nothing changed until then, at most an interval ago."""
        half_ns = 0.5e6 * HEARTBEAT_MS
        return [self._sample(received_ns - round(half_ns), round(half_ns / math.sqrt(3.0)))]

    def _sample(self, ours_ns: int, uncertainty_ns: int) -> ControlSample:
        measured, unusable = self._values("measured")
        commanded = self._values("commanded")[0]
        notes = self._described.notes
        if self._of_tool_point():
            measured = {a: v for a, v in measured.items() if a not in POINT} | self._path(unusable)
            commanded = {a: v for a, v in commanded.items() if a not in POINT}
            notes += () if self._tool_point or not measured else (TOOL_POINT_ONLY,)
        elif self._has("path") and not {*POINT} & {*measured, *unusable}:
            unusable |= dict.fromkeys(POINT, TOOL_POINT_BESIDE_AXES)
        roles = ("measured", "path") if self._of_tool_point() else ("measured",)
        told = [pair for role in roles for pair in self._texts_of(role)]
        return ControlSample(
            stamp_ns=ros_from_monotonic_ns(ours_ns),
            stamp_uncertainty_ns=uncertainty_ns,
            positions=measured,
            turning={item.axis: item.turns for item, _ in told if item.axis},
            unseen={
                axis: hidden for item, text in told for axis, hidden in unseen(item, text).items()
            },
            unusable=unusable,
            notes=notes,
            commanded=commanded,
            in_position=self._in_position(),
            fault=self._fault(),
            mode=_MODES.get(self._event("mode"), Mode.UNKNOWN),
            program_state=_PROGRAM_STATES.get(self._event("execution"), ProgramState.UNKNOWN),
            program=self._event("program"),
            program_line=line(self._event("line")),
        )

    def _of_tool_point(self) -> bool:
        """Return whether X, Y, Z are those of the tool point, by wish or for want of axes.

        Beside a rotary axis they are by wish only: the tool point is then not where X, Y, Z are.
        """
        has_axes = self._has("measured") or bool(self._described.unusable)
        return self._has("path") and (self._tool_point or not has_axes)

    def _has(self, role: str) -> bool:
        return any(item.role == role for item in self._described.items.values())

    def _texts_of(self, role: str) -> list[tuple[Item, str]]:
        return [
            (item, self._texts.get(item_id, UNAVAILABLE))
            for item_id, item in self._described.items.items()
            if item.role == role
        ]

    def _values(self, role: str) -> tuple[dict[str, float], dict[str, str]]:
        """Return the positions by axis, and why others cannot be used."""
        values: dict[str, float] = {}
        unusable = dict(self._described.unusable)
        for item, text in self._texts_of(role):
            value = number(text)
            why = text if text == UNAVAILABLE else why_not(value, text, item)
            if value is None or why:
                unusable[item.axis] = why
            else:
                values[item.axis] = value * item.scale
        return values, unusable

    def _path(self, unusable: dict[str, str]) -> dict[str, float]:
        """Return the tool point of a control that reports no axes (reported: tool_point)."""
        for axis in POINT:
            unusable.pop(axis, None)  # of an axis that is not wanted
        for item, text in self._texts_of("path"):
            values = [number(word) for word in text.split()[:4]]
            if len(values) != 3 or None in values:
                why = text if text == UNAVAILABLE else f"{text[:80]!r} is not three numbers"
                unusable |= dict.fromkeys(POINT, f"tool point: {why}")
                return {}
            return {axis: v * item.scale for axis, v in zip(POINT, values) if v is not None}
        return {}

    def _event(self, role: str) -> str:
        return next((text for _, text in self._texts_of(role) if text != UNAVAILABLE), "")

    def _in_position(self) -> bool | None:
        states = [text for _, text in self._texts_of("axis_state") if text != UNAVAILABLE]
        return all(state != "TRAVEL" for state in states) if states else None

    def _fault(self) -> str | None:
        if any(text == UNAVAILABLE for _, text in self._texts_of("availability")):
            return "the agent does not hear the control (UNAVAILABLE)"
        return None


def _address(url: str) -> SplitResult:
    """Return the agent's address; HOST:PORT alone would be taken for something else."""
    try:
        parts = urlsplit(url)
        is_one = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
    except ValueError:
        is_one = False
    if not is_one:
        raise InputError(f"Expected mtconnect_url as http://HOST:PORT, got {url!r}.")
    return parts
