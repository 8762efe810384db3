"""The MTConnect adapter against an agent over HTTP, fault cases included."""

import contextlib
import math
import threading
import time
from email.message import Message
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from mtconnect_agent import GOOD, PROBE, Agent

from omm_cnc_bridge.control import Mode, ProgramState
from omm_cnc_bridge.controls.mtconnect import multipart
from omm_cnc_bridge.controls.mtconnect.control import MtConnectControl
from omm_cnc_bridge.controls.mtconnect.model import read_device, read_document, stamp_ns
from omm_core.errors import DeviceError, InputError


class Mover:
    """Moves X at 100 Hz in a thread."""

    def __init__(self, agent: Agent) -> None:
        self._agent, self._stop = agent, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        x = 0.0
        while not self._stop.wait(0.01):
            x += 0.1
            self._agent.tell(xa=x, xc=x + 0.02)


@pytest.fixture(params=["1.3", "2.2"])
def agent(request):
    with Agent(version=request.param) as running:
        running.tell(**GOOD)
        yield running


@pytest.fixture
def control(agent):
    made = MtConnectControl(agent.url, rate_hz=100)
    made.connect()
    yield made
    made.close()


def read(control, seconds, until=lambda s: False):
    samples = []
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        for sample in control.read(0.05):
            samples.append(sample)
            if until(sample):
                return samples
    return samples


def test_axes_units_and_state_are_what_the_device_declares(control):
    last = read(control, 2.0, lambda s: True)[-1]
    assert last.positions == pytest.approx({"X": 71.45, "Y": -2.0, "B": math.pi / 2}, abs=1e-12)
    assert last.commanded == pytest.approx({"X": 71.45})
    assert (last.mode, last.program_state) == (Mode.AUTOMATIC, ProgramState.RUNNING)
    assert (last.program, last.program_line) == ("measure.ngc", 12)
    assert last.fault is None


def test_every_motion_arrives_once_in_order_with_its_stamp(agent, control):
    with Mover(agent):
        read(control, 3.0)
        samples = read(control, 2.0)
    x = np.array([s.positions["X"] for s in samples])
    steps = np.diff(x[x != 71.45])
    assert np.all(steps > -1e-9)
    assert np.max(steps) < 0.1001  # not one of 100 values a second is missing
    assert len(samples) > 100
    assert 0 < time.time_ns() - samples[-1].stamp_ns < 500_000_000


def test_at_rest_heartbeats_make_samples_that_admit_their_interval(control):
    samples = read(control, 2.0)
    assert len(samples) > 40
    assert all(5_000_000 < s.stamp_uncertainty_ns < 10_000_000 for s in samples)


def test_unavailable_is_a_fault(agent, control):
    read(control, 0.3)
    agent.tell(xa="UNAVAILABLE")
    assert read(control, 2.0, lambda s: s.unusable)[-1].unusable == {"X": "UNAVAILABLE"}
    agent.tell(avail="UNAVAILABLE")
    last = read(control, 2.0, lambda s: "agent" in (s.fault or ""))[-1]
    assert "does not hear the control" in last.fault


def test_agent_restart_is_noticed_and_survived(agent, control):
    read(control, 0.3)
    agent.restart()
    with pytest.raises(DeviceError, match="restarted"):
        read(control, 3.0)
    agent.tell(**GOOD)
    control.connect()
    assert read(control, 2.0, lambda s: s.fault is None)


def test_an_agent_restarted_with_a_model_that_does_not_fit_is_waited_for(agent, control):
    """It ends nothing: the model may fit again. At the start it is the wrong agent, or device."""
    read(control, 0.3)
    agent.probe = PROBE.replace('"Linear"', '"Sensor"').replace("Linear", "Sensor").replace(
        "Rotary", "Sensor"
    )  # fmt: skip
    agent.restart()
    with pytest.raises(DeviceError, match="restarted"):
        read(control, 3.0)
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"machine coordinates.*another model"):
            control.connect()
    with pytest.raises(InputError, match="positions in machine coordinates"):
        MtConnectControl(agent.url, rate_hz=100).connect()
    agent.probe = PROBE
    agent.restart()
    agent.tell(**GOOD)
    control.connect()
    assert read(control, 2.0, lambda s: s.positions.get("X") == 71.45)


def test_parts_that_do_not_tell_their_length_are_read_as_soon():
    """Some proxies leave it out. Waiting for the next boundary would cost a heartbeat."""
    with Agent(lengths=False) as agent:
        agent.tell(**GOOD)
        control = MtConnectControl(agent.url, rate_hz=100)
        control.connect()
        assert len(read(control, 2.0)) > 40
        with Mover(agent):
            read(control, 0.5)
            x = [s.positions["X"] for s in read(control, 1.0)]
        assert np.max(np.diff([value for value in x if value != 71.45])) < 0.1001
        control.close()


class Sent:
    """An answer that comes in the given pieces."""

    def __init__(self, pieces):
        self.pieces = list(pieces)
        self.headers = Message()
        self.headers["Content-Type"] = "multipart/mixed;boundary=x"

    def read1(self, _):
        return self.pieces.pop(0) if self.pieces else b""

    def close(self):
        """Nothing to close."""


@pytest.mark.parametrize("size", [1, 7, 10_000])
def test_parts_with_and_without_a_length_may_come_in_any_pieces(size):
    """By its length, by the end of its document, or by the next boundary."""
    first, second = sample_text(value="1.5"), sample_text(value="2.5") + b"\r\n"
    sent = b"--x\r\nContent-length: %d\r\n\r\n%s\r\n" % (len(first), first)
    sent += b"--x\r\nContent-type: text/xml\r\n\r\n" + second
    sent += b"--x\r\nA: b\r\n\r\nno document\r\n--x\r\n\r\n" + first + b"\r\n--x--"
    reader = multipart.MultipartReader(Sent(sent[i : i + size] for i in range(0, len(sent), size)))
    parts: list[bytes] = []
    while len(parts) < 4:
        parts += [part for _, part in reader.read(1.0)]
    assert parts == [first, second.strip(), b"no document", first]


def test_an_overrun_buffer_is_not_passed_over():
    with Agent(size=16) as agent:
        agent.tell(**GOOD)
        control = MtConnectControl(agent.url, rate_hz=100)
        control.connect()
        agent.hang = True
        for x in range(100):
            agent.tell(xa=x)
        agent.hang = False
        with pytest.raises(DeviceError, match="overflowed"):
            read(control, 3.0)
        control.connect()
        assert read(control, 2.0, lambda s: s.positions.get("X") == 99.0)
        control.close()


def test_an_agent_that_hangs_gives_no_samples_and_is_given_up(agent, control):
    read(control, 0.3)
    agent.hang = True
    read(control, 0.2)
    assert read(control, 1.0) == []
    with pytest.raises(DeviceError, match="silent"):
        read(control, 6.0)


def test_a_clock_an_hour_off_is_mapped(agent, control):
    agent.clock_s = -3600.0
    with Mover(agent):
        read(control, 2.0)
        last = read(control, 1.0)[-1]
    assert abs(time.time_ns() - last.stamp_ns) < 300_000_000


def test_no_agent_is_a_device_error():
    with pytest.raises(DeviceError, match=r"127\.0\.0\.1:9"):
        MtConnectControl("http://127.0.0.1:9", rate_hz=100).connect()


def test_unknown_device_names_those_that_are_there(agent):
    with pytest.raises(InputError, match="the agent has mill"):
        MtConnectControl(agent.url, rate_hz=100, device="lathe").connect()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-11-22T20:00:00Z", 1795377600_000000000),
        ("2026-11-22T20:00:00.5Z", 1795377600_500000000),
        ("2026-11-22T20:00:00.123456789Z", 1795377600_123456789),
    ],
)
def test_stamps_keep_every_digit(text, expected):
    assert stamp_ns(text) == expected


def test_errors_of_the_agent_are_passed_on():
    text = b"""<MTConnectError><Header/><Errors><Error errorCode="OUT_OF_RANGE">'from' must be
        greater than 0.</Error></Errors></MTConnectError>"""
    with pytest.raises(DeviceError, match="OUT_OF_RANGE"):
        read_document(text)


def test_work_coordinates_alone_are_refused():
    item = b'<DataItem id="x" type="POSITION" units="MILLIMETER" coordinateSystem="WORK"/>'
    axis = b'<Linear name="X"><DataItems>' + item + b"</DataItems></Linear>"
    text = b'<MTConnectDevices><Devices><Device name="m">' + axis
    text += b"</Device></Devices></MTConnectDevices>"
    with pytest.raises(InputError, match="machine coordinates"):
        read_device(text, "")


def sample_text(header: str = "", value: str = "1.5", stamp: str = "2026-01-01T00:00:00Z") -> bytes:
    head = header or 'instanceId="1" firstSequence="1" lastSequence="9" nextSequence="10"'
    return (
        f"<MTConnectStreams><Header {head}/><Streams>"
        f'<Position dataItemId="xa" sequence="7" timestamp="{stamp}">{value}</Position>'
        "</Streams></MTConnectStreams>"
    ).encode()


def test_a_value_that_the_agent_calls_invalid_is_none() -> None:
    text = sample_text().replace(b"<Position ", b'<Position quality="INVALID" ')
    assert read_document(text).observations[0].text == "INVALID: 1.5"
    assert read_document(sample_text()).observations[0].text == "1.5"


@pytest.mark.parametrize(
    "text",
    [
        sample_text('instanceId="1" firstSequence="1" lastSequence="9" nextSequence="99999"'),
        sample_text(f'instanceId="1" firstSequence="{"9" * 5000}" nextSequence="10"'),
        sample_text('instanceId="1" firstSequence="1" nextSequence="²"'),
        sample_text(stamp="2026-13-01T00:00:00Z"),
        sample_text(stamp=f"{'9' * 5000}-01-01T00:00:00Z"),
        sample_text(stamp="٢٠٢٦-01-01T00:00:00Z"),
        b'<?xml version="1.0" encoding="utf-7"?>' + sample_text(),
        b'<?xml version="1.0" encoding="no-such"?>' + sample_text(),
        b"",
        b"\x00" * 100,
    ],
)
def test_a_document_that_is_none_is_refused_in_words(text: bytes) -> None:
    with pytest.raises(DeviceError, match="MTConnect"):
        read_document(text)


@pytest.mark.parametrize(
    "text", ["", "1,5", "nan", "inf", "1e999", "1e300", "9" * 5000, "0x10", "a", "1_0", "١٢"]
)
def test_a_position_that_is_no_number_is_told_by_its_axis(
    control: MtConnectControl, agent: Agent, text: str
) -> None:
    agent.tell(xa=text)
    (*_, sample) = read(control, 10.0, lambda s: "X" in s.unusable)
    assert "X" not in sample.positions
    assert "not a number" in sample.unusable["X"]
    agent.tell(xa=12.5, line="²")
    (*_, sample) = read(control, 10.0, lambda s: "X" in s.positions)
    assert sample.positions["X"] == 12.5
    assert sample.program_line == -1


class Endless(BaseHTTPRequestHandler):
    """Answers without an end, or one byte at a time."""

    piece = b"<a>" * 20_000

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/xml")
        self.end_headers()
        with contextlib.suppress(OSError):
            while True:
                self.wfile.write(self.piece)
                if len(self.piece) == 1:
                    time.sleep(0.01)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.mark.parametrize("piece", [b"<a>" * 20_000, b"<"])
def test_an_answer_without_an_end_is_given_up(
    piece: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Endless, "piece", piece)
    monkeypatch.setattr(multipart, "ANSWER_S", 1.0)
    server = ThreadingHTTPServer(("127.0.0.1", 0), Endless)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        control = MtConnectControl(f"http://127.0.0.1:{server.server_port}", rate_hz=100)
        with pytest.raises(DeviceError, match="no end"):
            control.connect()
    finally:
        server.shutdown()
        server.server_close()


def test_a_part_that_says_it_is_endless_is_not_waited_for() -> None:
    for length in (b"9" * 5000, b"99999999999", b"-1"):
        with pytest.raises(DeviceError, match="part"):
            multipart._content_length(b"--x\r\nContent-Length: " + length)
