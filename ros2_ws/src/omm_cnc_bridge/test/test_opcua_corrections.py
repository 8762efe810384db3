"""The correction of the next stop, written to a real OPC UA server: whole, or not valid."""

import socket
import time

import pytest
from opcua_server import OpcUaTestServer

from omm_cnc_bridge.control import TakesCorrections
from omm_cnc_bridge.controls.choosing import make_control
from omm_cnc_bridge.controls.opcua.control import OpcUaControl
from omm_cnc_bridge.controls.opcua.corrections import CorrectedOpcUaControl
from omm_cnc_bridge.controls.opcua.mapping import load_mapping
from omm_core.errors import DeviceError, InputError

MAPPING = """
axes:
  X: {position: CncInterface/CncAxisList/X/PosDirect, unit: mm}
channel: {measure_request: Vendor/ImageWanted}
acknowledge: Vendor/ImageTaken
correction: {X: Vendor/StopX, Y: Vendor/StopY, Z: Vendor/StopZ, status: Vendor/StopStatus,
             valid: Vendor/StopValid}
"""


@pytest.fixture
def server():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    made = OpcUaTestServer(port)
    made.corrected = {"X": 0.0, "Y": 0.0, "Z": 0.0, "Status": 0, "Valid": False, "Whole": 0}
    with made as running:
        yield running


@pytest.fixture
def led(server, tmp_path):
    opened = []

    def connected(text=MAPPING):
        (tmp_path / "mapping.yaml").write_text(text)
        file = str(tmp_path / "mapping.yaml")
        control = CorrectedOpcUaControl(server.url, rate_hz=50, mapping_file=file)
        opened.append(control)
        control.connect()
        return control

    yield connected
    for control in opened:
        control.close()


def reaches(server, **wanted):
    """Wait until the server holds these values."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        if {name: server.corrected[name] for name in wanted} == wanted:
            return True
        time.sleep(0.01)
    return False


def test_a_correction_arrives_as_it_was_told_and_is_taken_back(server, led):
    control = led()
    assert isinstance(control, TakesCorrections)
    control.correct((1.5, -2.25, 1e-3), 2, valid=True)
    assert reaches(server, X=1.5, Y=-2.25, Z=1e-3, Status=2, Valid=True)
    control.correct((0.0, 0.0, 0.0), 0, valid=False)
    assert reaches(server, Valid=False)


def test_numbers_change_only_while_valid_is_taken_back(server, led):
    control = led()
    for number in range(1, 6):
        control.correct((float(number),) * 3, 1, valid=True)
    assert reaches(server, X=5.0, Valid=True)
    for seen in server.corrections:
        if seen["Valid"]:
            assert seen["X"] == seen["Y"] == seen["Z"]


def test_the_mapping_s_unit_is_kept(server, led):
    led(MAPPING.replace("correction: {", "correction: {unit: m, ")).correct(
        (250.0, 0.0, -30.0), 1, valid=True
    )
    assert reaches(server, X=0.25, Z=-0.03, Valid=True)


def test_a_node_that_holds_whole_numbers_takes_no_shift(server, led):
    control = led(MAPPING.replace("X: Vendor/StopX, Y", "X: Vendor/StopWhole, Y"))
    with pytest.raises(DeviceError, match="node X"):
        control.correct((1.5, 0.0, 0.0), 1, valid=True)
    assert reaches(server, Valid=False)


def test_a_control_that_is_not_connected_says_so(tmp_path):
    (tmp_path / "mapping.yaml").write_text(MAPPING)
    control = CorrectedOpcUaControl(
        "opc.tcp://127.0.0.1:9/cnc", rate_hz=50, mapping_file=str(tmp_path / "mapping.yaml")
    )
    with pytest.raises(DeviceError, match="not connected"):
        control.correct((0.0, 0.0, 0.0), 0, valid=False)


def test_only_a_mapping_that_names_the_nodes_takes_corrections(tmp_path):
    from dataclasses import replace

    from omm_cnc_bridge.parameters import Parameters

    machine = tmp_path / "none.urdf"
    for text, kind in ((MAPPING, CorrectedOpcUaControl), (MAPPING.split("corr")[0], OpcUaControl)):
        (tmp_path / "mapping.yaml").write_text(text)
        p = replace(
            Parameters(), control="opcua", opcua_mapping_file=str(tmp_path / "mapping.yaml"),
            machine_file=str(machine),
        )  # fmt: skip
        machine.write_text(MACHINE)
        control, _ = make_control(p)
        assert type(control) is kind
        assert isinstance(control, TakesCorrections) == (kind is CorrectedOpcUaControl)


MACHINE = """<robot name="m"><link name="machine"/><link name="spindle"/>
<joint name="X" type="prismatic"><parent link="machine"/><child link="spindle"/>
<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="0" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ((", Y: Vendor/StopY", ""), "Y"),
        (("valid: Vendor/StopValid", "valid: Vendor/StopX"), "twice"),
        (("status: ", "state: "), "state is not known|'state'"),
        (("correction: {", "correction: {unit: rad, "), "unit"),
    ],
)
def test_a_mapping_that_names_no_whole_correction_is_refused(tmp_path, change, told):
    path = tmp_path / "mapping.yaml"
    path.write_text(MAPPING.replace(*change))
    with pytest.raises(InputError, match=told):
        load_mapping(path)
