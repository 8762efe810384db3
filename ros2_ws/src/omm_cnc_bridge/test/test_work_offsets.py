"""Work offsets: written only where that is allowed, into what is named, and read back."""

import asyncio
import math
import threading
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")
pytest.importorskip("omm_interfaces", reason="the workspace is not built (./omm setup)")

from asyncua import Server, ua
from node_bench import Bench
from omm_interfaces.srv import WorkOffset
from peers import free_port

from omm_cnc_bridge.control import WorkOffset as Offset
from omm_cnc_bridge.controls.linuxcnc import offsets
from omm_cnc_bridge.controls.linuxcnc.cell import LinuxCncCell, is_installed
from omm_cnc_bridge.controls.opcua.control import OpcUaControl
from omm_cnc_bridge.controls.opcua.mapping import load_mapping
from omm_core.errors import DeviceError, InputError

MACHINE = Path(__file__).parents[1] / "machines" / "three_axis_mill.urdf"
needs_linuxcnc = pytest.mark.skipif(
    not is_installed(), reason="LinuxCNC is not installed (apt-get install linuxcnc-uspace)"
)
TURN_RAD = math.radians(30.0)
D_MM = np.array([12.345678, 5.5, 1.25])


def ask(bench: Bench, name: str, *, write: bool = False, d_mm=D_MM, turn=(0.0, 0.0, TURN_RAD)):
    request = WorkOffset.Request(name=name, write=write)
    if write:
        request.position, request.euler_xyz = np.asarray(d_mm) / 1000.0, np.asarray(turn)
    return bench.wait_for(bench.send(WorkOffset, "/cnc_bridge/work_offset", request))


def is_what_was_written(answer) -> bool:
    return bool(
        answer.success
        and np.allclose(answer.position, D_MM / 1000.0, rtol=0, atol=1e-9)
        and np.allclose(answer.euler_xyz, [0.0, 0.0, TURN_RAD], rtol=0, atol=1e-9)
    )


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    with LinuxCncCell("three_axis_mill", tmp_path_factory.mktemp("linuxcnc")) as running:
        yield running


def linuxcnc(cell) -> dict[str, object]:
    reader = f"[{', '.join(cell.reader)}]"
    return {"control": "linuxcnc", "machine_file": MACHINE, "linuxcnc_reader": reader}


def at_rest(bench: Bench) -> bool:
    return bool(bench.states) and bench.states[-1].in_position and bench.states[-1].mode != 0


@needs_linuxcnc
def test_linuxcnc_then_moves_where_the_offset_says(cell, bench, start_node):
    start_node(**linuxcnc(cell), allow_commands=True)
    assert bench.spin(20.0, lambda: at_rest(bench))
    assert is_what_was_written(ask(bench, "G54", write=True))
    assert is_what_was_written(ask(bench, "G54"))
    p = np.array([10.0, 20.0, 3.0])
    assert bench.mdi(f"G54 G90 G21 G1 F6000 X{p[0]} Y{p[1]} Z{p[2]}").success
    assert bench.spin(5.0, lambda: at_rest(bench))
    bench.spin(0.3)
    c, s = math.cos(TURN_RAD), math.sin(TURN_RAD)
    expected = D_MM + np.array([c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]])
    assert np.allclose(bench.states[-1].axis_commanded, expected / 1000.0, rtol=0, atol=1e-8)


@needs_linuxcnc
def test_units_distance_mode_and_the_active_offset_stay_as_they_were(cell, bench, start_node):
    start_node(**linuxcnc(cell), allow_commands=True)
    assert bench.spin(20.0, lambda: at_rest(bench))
    assert bench.mdi("G53 G0 X10 Y10 Z10").success
    assert bench.mdi("G55").success
    assert bench.mdi("G20 G91").success
    try:
        assert bench.spin(5.0, lambda: at_rest(bench))
        assert is_what_was_written(ask(bench, "G54", write=True))
        answer = ask(bench, "G54")
        assert (answer.success, "G55 is" in answer.message) == (False, True)
        before = np.array(bench.states[-1].axis_commanded)
        assert bench.mdi("G0 X0.1").success  # an inch's tenth, from here
        assert bench.spin(5.0, lambda: at_rest(bench))
        bench.spin(0.3)
        moved = np.array(bench.states[-1].axis_commanded) - before
        assert np.allclose(moved, [2.54e-3, 0.0, 0.0], rtol=0, atol=1e-8)
    finally:
        bench.mdi("G21 G90")
        bench.mdi("G54")


@needs_linuxcnc
def test_linuxcnc_is_not_written_to_while_it_moves_or_where_that_is_not_allowed(
    cell, bench, start_node
):
    start_node(**linuxcnc(cell))
    assert bench.spin(20.0, lambda: at_rest(bench))
    answer = ask(bench, "G54", write=True, d_mm=[1.0, 1.0, 1.0])
    assert (answer.success, "allow_commands" in answer.message) == (False, True)
    assert not np.allclose(ask(bench, "G54").position, 1e-3)


@needs_linuxcnc
def test_a_machine_that_moves_is_not_written_to(cell, bench, start_node):
    start_node(**linuxcnc(cell), allow_commands=True, mdi_timeout_s=0.2)
    assert bench.spin(20.0, lambda: at_rest(bench))
    bench.mdi("G53 G1 F300 X40")  # goes on for seconds
    answer = ask(bench, "G54", write=True)
    assert (answer.success, "not at rest" in answer.message) == (False, True)


def test_the_simulated_control_keeps_its_offsets(bench, start_node):
    start_node(control="simulated", start_program=False)
    assert bench.spin(20.0, lambda: at_rest(bench))
    assert np.array_equal(ask(bench, "G55").position, [0.0, 0.0, 0.0])
    assert is_what_was_written(ask(bench, "G55", write=True))
    assert is_what_was_written(ask(bench, "G55"))
    answer = ask(bench, "G12; M30", write=True)
    assert (answer.success, "Expected one of the offsets" in answer.message) == (False, True)


BAD = {
    "no such offset": {"name": "G60"},
    "words in the name": {"name": "G54\nM3 S20000"},
    "a tilt": {"euler_xyz_rad": (1e-6, 0.0, 0.0)},
    "no number": {"xyz_mm": (math.nan, 0.0, 0.0)},
    "no end": {"euler_xyz_rad": (0.0, 0.0, math.inf)},
    "out of every machine": {"xyz_mm": (0.0, 1e9, 0.0)},
}


@pytest.mark.parametrize("case", BAD)
def test_no_block_is_made_of_what_linuxcnc_cannot_say(case):
    good = {"name": "G54", "xyz_mm": (1.0, 2.0, 3.0), "euler_xyz_rad": (0.0, 0.0, 0.1)}
    with pytest.raises(DeviceError):
        offsets.block({}, Offset(**(good | BAD[case])))


def test_g92_on_top_of_the_offset_is_refused():
    good = Offset(name="G54", xyz_mm=(1.0, 2.0, 3.0), euler_xyz_rad=(0.0, 0.0, 0.1))
    assert offsets.block({"g92": [0.0] * 6}, good).startswith("G21 G90 G10 L2 P1 X1.000000000")
    with pytest.raises(DeviceError, match="G92"):
        offsets.block({"g92": [0.0, 1.0, 0, 0, 0, 0]}, good)


# --- OPC UA ------------------------------------------------------------------------------------

MAPPING = """
axes: {X: {position: Frames/Actual, unit: mm}}
offsets:
  G54: {X: Frames/X, Y: Frames/Y, Z: Frames/Z, A: Frames/A, B: Frames/B, C: Frames/C,
        unit: m, angle_unit: deg, angles: rpy}
  G55: {X: Frames/X2, Y: Frames/Y2, Z: Frames/Z2}
  G56: {X: Frames/X3, Y: Frames/Locked, Z: Frames/Z3}
  G57: {X: Frames/X4, Y: Frames/Whole, Z: Frames/Z4}
"""
NODES = ("Actual", *(f"{axis}{k}" for k in ("", 2, 3, 4) for axis in "XYZ"), *"ABC", "Locked")


class Frames:
    """A server that keeps frames; ``written`` is what each node holds."""

    def __init__(self) -> None:
        self.url = f"opc.tcp://127.0.0.1:{free_port()}/frames"
        self.holds: dict[str, float] = {}
        self._ready, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)

    def __enter__(self) -> "Frames":
        self._thread.start()
        assert self._ready.wait(30.0)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(10.0)

    async def _run(self) -> None:
        server = Server()
        await server.init()
        server.set_endpoint(self.url)
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        space = await server.register_namespace("urn:frames")
        folder = await server.nodes.objects.add_object(space, "Frames")
        nodes = {}
        for name in (*NODES, "Whole"):
            nodes[name] = await folder.add_variable(space, name, 7 if name == "Whole" else 0.5)
            if name not in ("Locked", "Actual"):
                await nodes[name].set_writable()
        async with server:
            self._ready.set()
            while not self._stop.is_set():
                await nodes["Actual"].write_value(0.5)
                self.holds = {name: await node.read_value() for name, node in nodes.items()}
                await asyncio.sleep(0.02)


@pytest.fixture(scope="module")
def frames():
    with Frames() as running:
        yield running


@pytest.fixture
def opcua(frames, tmp_path):
    (tmp_path / "mapping.yaml").write_text(MAPPING)
    control = OpcUaControl(frames.url, rate_hz=50, mapping_file=str(tmp_path / "mapping.yaml"))
    control.connect()
    yield control
    control.close()


def test_opcua_nodes_get_the_pose_in_their_units(frames, opcua):
    offset = Offset(
        name="G54", xyz_mm=(812.345, -410.25, 155.02), euler_xyz_rad=(2e-3, -3e-3, 4e-3)
    )
    read = opcua.set_work_offset(offset, 5.0)
    assert read.xyz_mm == pytest.approx(offset.xyz_mm, abs=1e-9)
    assert read.euler_xyz_rad == pytest.approx(offset.euler_xyz_rad, abs=1e-12)
    assert opcua.work_offset("G54") == read
    wait(lambda: frames.holds["C"] != 0.5)
    assert [frames.holds[n] for n in "XYZ"] == pytest.approx([0.812345, -0.41025, 0.15502])
    expected = [0.114591559, -0.171887339, 0.229183118]  # of the facts, worked by hand
    assert [frames.holds[n] for n in "ABC"] == pytest.approx(expected, abs=1e-9)
    untouched = [n for n in NODES if n not in ("X", "Y", "Z", "A", "B", "C")]
    assert {frames.holds[n] for n in untouched} == {0.5}


def wait(condition) -> None:
    for _ in range(200):
        if condition():
            return
        threading.Event().wait(0.02)
    raise AssertionError("it did not come")


@pytest.mark.parametrize(
    ("name", "turn", "words"),
    [("G58", 0.0, "names no nodes"), ("G55", 1e-3, "no node C"), ("G56", 0.0, "Node Y"),
     ("G57", 0.0, "Node Y")],
)  # fmt: skip
def test_opcua_writes_all_of_an_offset_or_nothing(frames, opcua, name, turn, words):
    offset = Offset(name=name, xyz_mm=(1.0, 2.0, 3.0), euler_xyz_rad=(0.0, 0.0, turn))
    with pytest.raises(DeviceError, match=words):
        opcua.set_work_offset(offset, 5.0)
    threading.Event().wait(0.2)
    assert {frames.holds[f"{axis}{k}"] for axis in "XYZ" for k in (2, 3, 4)} == {0.5}


@pytest.mark.parametrize(
    "text",
    ["offsets: [G54]", "offsets: {G54: {X: a, Y: b}}", "offsets: {G54: {X: a, Y: b, Z: c, W: d}}",
     "offsets: {G54: {X: a, Y: b, Z: c, unit: parsec}}", "offsets: {G54: {X: a, Y: a, Z: c}}",
     "offsets: {G54: {X: a, Y: b, Z: c, angles: zxz}}", "offsets: {G54: {X: [1], Y: b, Z: c}}",
     "offsets: {G54: {X: a, Y: b, Z: c, angle_unit: turns}}"],
)  # fmt: skip
def test_a_mapping_of_offsets_that_is_not_clear_is_refused(tmp_path, text):
    path = tmp_path / "mapping.yaml"
    path.write_text("axes: {X: {position: p}}\n" + text)
    with pytest.raises(InputError, match="offsets"):
        load_mapping(path)
