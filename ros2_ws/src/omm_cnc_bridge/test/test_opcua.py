"""The OPC UA adapter against servers over real connections: asyncua's, and node-opcua's."""

import hashlib
import math
import socket
import time
from pathlib import Path

import numpy as np
import pytest

from omm_core.errors import DeviceError, InputError

pytest.importorskip("asyncua", reason="asyncua is not installed")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

import node_opcua  # noqa: E402
from opcua_server import OpcUaTestServer  # noqa: E402

from omm_cnc_bridge.control import Mode, ProgramState  # noqa: E402
from omm_cnc_bridge.controls.opcua.control import OpcUaControl  # noqa: E402
from omm_cnc_bridge.controls.opcua.logging_in import Security  # noqa: E402
from omm_cnc_bridge.controls.opcua.mapping import load_mapping  # noqa: E402

CONTROLS = Path(__file__).parents[1] / "controls"
MAPPING = """
axes:
  X: {position: CncInterface/CncAxisList/X/PosDirect, unit: mm}
  B: {position: CncInterface/CncAxisList/B/PosDirect/ActPos, unit: deg}
channel: {measure_request: Vendor/ImageWanted}
acknowledge: Vendor/ImageTaken
"""


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.fixture
def server():
    with OpcUaTestServer(free_port()) as running:
        yield running


@pytest.fixture
def control(server):
    made = OpcUaControl(server.url, rate_hz=100)
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


def test_axes_are_found_by_name_with_units_and_state(server, control):
    server.positions.update(X=12.5, Y=-3.0, B=90.0)
    server.commanded.update(X=12.5, Y=-3.0, B=90.0)
    samples = read(control, 5.0, lambda s: s.positions.get("X") == 12.5)
    last = samples[-1]
    assert last.positions == pytest.approx({"X": 12.5, "Y": -3.0, "B": math.pi / 2}, abs=1e-12)
    assert last.commanded == pytest.approx(last.positions)
    assert last.in_position is True
    assert (last.mode, last.program_state) == (Mode.AUTOMATIC, ProgramState.RUNNING)
    assert last.program == "measure.mpf"
    assert last.spindle_angle_rad == pytest.approx(math.radians(45.0))


def test_samples_flow_at_rest_and_their_stamps_are_the_sources(server, control):
    """Nothing moves: a server that only reports changes must not look dead."""
    read(control, 3.0)
    samples = read(control, 2.0)
    now_ns = time.time_ns()
    stamps = np.array([s.stamp_ns for s in samples])
    assert len(samples) > 100
    assert np.all(np.diff(stamps) > 0)
    assert 0 < now_ns - stamps[-1] < 300_000_000
    assert samples[-1].stamp_uncertainty_ns < 10_000_000


def test_moving_is_told(server, control):
    server.status = 1
    assert read(control, 5.0, lambda s: s.in_position is False)[-1].in_position is False


def test_bad_quality_is_a_fault(server, control):
    from asyncua import ua

    read(control, 1.0)
    server.quality = ua.StatusCodes.BadNoCommunication
    last = read(control, 5.0, lambda s: set(s.unusable) == {"X", "Y", "B"})[-1]
    assert "BadNoCommunication" in last.unusable["X"]


def test_a_clock_that_is_off_by_an_hour_and_then_jumps_is_mapped(server, control):
    server.clock_s = 3600.0
    read(control, 3.0)
    for jump_s in (3600.0, -7200.0):
        server.clock_s += jump_s
        read(control, 4.0)
        last = read(control, 1.0)[-1]
        assert abs(time.time_ns() - last.stamp_ns) < 300_000_000


def test_a_control_that_hangs_behind_a_living_server_is_not_at_rest(server, control):
    assert read(control, 1.0)
    server.hang = True
    read(control, 0.5)
    assert read(control, 1.0) == []


def test_request_and_acknowledgement_through_a_mapping(server, tmp_path):
    path = tmp_path / "mapping.yaml"
    path.write_text(MAPPING)
    control = OpcUaControl(server.url, rate_hz=100, mapping_file=str(path))
    control.connect()
    try:
        server.request = 7
        assert read(control, 5.0, lambda s: s.measure_request == 7)[-1].measure_request == 7
        assert math.isnan(read(control, 1.0, lambda s: True)[-1].spindle_angle_rad)  # not mapped
        control.acknowledge(7)
        deadline = time.monotonic() + 3
        while server.acknowledged != 7 and time.monotonic() < deadline:
            time.sleep(0.02)
    finally:
        control.close()
    assert server.acknowledged == 7


def test_a_server_that_goes_away_is_noticed_and_found_again():
    port = free_port()
    control = OpcUaControl(f"opc.tcp://127.0.0.1:{port}/cnc", rate_hz=100)
    with pytest.raises(DeviceError):
        control.connect()
    for _ in range(2):
        with OpcUaTestServer(port):
            control.connect()
            assert read(control, 5.0, lambda s: True)
        with pytest.raises(DeviceError):
            read(control, 15.0)
        control.close()


@pytest.fixture(autouse=True)
def own_data_folder(tmp_path, monkeypatch):
    """Our certificate and the servers we know are those of the test."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


def connected(server, **options):
    """What a control with these options says when it has heard a sample."""
    control = OpcUaControl(server.url, rate_hz=100, security=Security(**options))
    try:
        control.connect()
        return read(control, 5.0, lambda s: True)[-1].notes
    finally:
        control.close()


def test_user_and_password_go_over_a_plain_channel_only_where_that_is_allowed(tmp_path):
    secret = tmp_path / "password"
    secret.write_text("secret\n")
    given = {"user": "omm", "password_file": str(secret)}
    with OpcUaTestServer(free_port(), login=True) as server:
        with pytest.raises(DeviceError, match=r"(?i)user|identity|access"):
            connected(server, **given)
        assert not any(name or password for name, password in server.users.asked)
        notes = connected(server, **given, allow_password_unencrypted=True)
        assert any("NOT ENCRYPTED" in note for note in notes)
        with pytest.raises(DeviceError, match=r"(?i)user|identity|access"):
            connected(server, **(given | {"user": "nobody"}), allow_password_unencrypted=True)
    with OpcUaTestServer(free_port()) as server:  # lets everybody in
        notes = connected(server, **given)
    assert any("as nobody, not as omm" in note for note in notes)


def test_what_is_offered_encrypted_is_used_encrypted_with_a_certificate_of_our_own(tmp_path):
    theirs, their_key = _certificate(tmp_path, "control")
    secret = tmp_path / "password"
    secret.write_text("secret\n")
    given = {"user": "omm", "password_file": str(secret)}
    with OpcUaTestServer(
        free_port(), certificate=theirs, key=their_key, plain_too=True, login=True
    ) as server:
        notes = connected(server, **given)
        assert not any("NOT ENCRYPTED" in note for note in notes)
        shown = hashlib.sha256(theirs.read_bytes()).hexdigest()
        assert any(shown in note for note in notes)
        assert ("omm", "secret") in server.users.asked
        assert not any("first time" in note for note in connected(server, **given))
        server.users.asked.clear()
        with pytest.raises(DeviceError):  # as nobody
            connected(server, **given, allow_unencrypted=True)
        assert not any(name or password for name, password in server.users.asked)
    key = tmp_path / "data" / "omm" / "opcua" / "omm.pem"
    assert key.stat().st_mode & 0o077 == 0


def test_a_server_that_is_another_one_now_is_refused(tmp_path):
    port = free_port()
    (theirs, their_key), (others, other_key) = (
        _certificate(tmp_path, name) for name in ("control", "other")
    )
    with OpcUaTestServer(port, certificate=theirs, key=their_key) as server:
        connected(server)
        with pytest.raises(InputError, match="another certificate"):
            connected(server, server_certificate_file=str(others))
    with OpcUaTestServer(port, certificate=others, key=other_key) as server:
        with pytest.raises(InputError, match="in between"):
            connected(server)
        connected(server, server_certificate_file=str(others))
    with OpcUaTestServer(port) as server:
        with pytest.raises(InputError, match="expected the encrypted endpoint"):
            connected(server)
        connected(server, allow_unencrypted=True)


def _certificate(folder: Path, name: str) -> tuple[Path, Path]:
    """A self-signed certificate (DER) and its private key (PEM)."""
    from asyncua.crypto import cert_gen
    from cryptography.hazmat.primitives.serialization import Encoding
    from cryptography.x509.oid import ExtendedKeyUsageOID

    key = cert_gen.generate_private_key()
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    names = [cert_gen.x509.UniformResourceIdentifier(f"urn:{name}")]
    certificate = cert_gen.generate_self_signed_app_certificate(key, name, {}, names, extended=uses)
    paths = folder / f"{name}.der", folder / f"{name}.pem"
    paths[0].write_bytes(certificate.public_bytes(Encoding.DER))
    paths[1].write_bytes(cert_gen.dump_private_key_as_pem(key))
    return paths


def test_signed_and_encrypted_with_basic256sha256(tmp_path):
    theirs, their_key = _certificate(tmp_path, "control")
    ours, our_key = _certificate(tmp_path, "omm")
    with OpcUaTestServer(free_port(), certificate=theirs, key=their_key) as server:
        with pytest.raises(InputError, match="it offers SignAndEncrypt"):
            connected(server, allow_unencrypted=True)
        security = Security(certificate_file=str(ours), private_key_file=str(our_key))
        control = OpcUaControl(server.url, rate_hz=100, security=security)
        control.connect()
        samples = read(control, 5.0, lambda s: True)
        control.close()
    assert samples


needs_node_opcua = pytest.mark.skipif(
    not node_opcua.is_installed(),
    reason="node-opcua is not installed (npm install -g node-opcua node-opcua-nodesets)",
)


def heard_of_node_opcua(*options: str):
    """Samples of three seconds, and the interval that the control believes in."""
    port = free_port()
    with node_opcua.node_opcua_server(port, *options):
        control = OpcUaControl(f"opc.tcp://127.0.0.1:{port}", rate_hz=100)
        control.connect()
        try:
            read(control, 4.0)
            return read(control, 3.0), control.revised_interval_s
        finally:
            control.close()


@needs_node_opcua
def test_an_independent_server_that_can_gives_every_change():
    """Asked for 10 ms it would give 50 ms; asked for its fastest it reports what changes."""
    samples, interval_s = heard_of_node_opcua("0")
    assert len(samples) > 150
    assert interval_s < 0.02
    stamps = [s.stamp_ns for s in samples]
    assert np.all(np.diff(stamps) > 0)
    speeds = np.diff([s.positions["X"] for s in samples]) / (np.diff(stamps) / 1e9)
    assert 5.0 < np.median(speeds) <= 11.0  # 0.1 mm every 10 ms: stamps go with the positions


@needs_node_opcua
def test_an_independent_server_with_the_cnc_nodeset():
    """node-opcua's as it is, with OPC 40502's own types; it revises 10 ms to 50 ms."""
    samples, interval_s = heard_of_node_opcua()
    x = [s.positions["X"] for s in samples]
    assert samples[-1].positions.keys() == {"X", "Y", "Z"}
    assert samples[-1].positions["Y"] == 5.0
    assert samples[-1].in_position is True
    assert np.all(np.diff(x) > 0)
    # 0.1 mm every 10 ms: whatever the interval, the stamps go with the positions.
    speed = (x[-1] - x[0]) / ((samples[-1].stamp_ns - samples[0].stamp_ns) / 1e9)
    assert 5.0 < speed <= 11.0
    assert interval_s > 0.03


@pytest.mark.parametrize(
    "text",
    [
        "axes: {}",
        "axes: {X: {}}",
        "axes: {X: {position: a, unit: ell}}",
        "axes: {X: {position: a}}\nwhat: 1",
    ],
)
def test_a_bad_mapping_is_refused(tmp_path, text):
    path = tmp_path / "mapping.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"mapping\.yaml"):
        load_mapping(path)


def test_a_path_that_is_not_there_says_what_is(server, tmp_path):
    path = tmp_path / "mapping.yaml"
    path.write_text("axes: {X: {position: CncInterface/CncAxisList/Q/PosDirect, unit: mm}}")
    control = OpcUaControl(server.url, rate_hz=100, mapping_file=str(path))
    with pytest.raises(InputError, match="the server has X, Y, B there"):
        control.connect()
    control.close()


@pytest.mark.parametrize("path", sorted(CONTROLS.glob("*.yaml")), ids=lambda p: p.stem)
def test_shipped_mappings_are_valid(path):
    assert load_mapping(path).axes
