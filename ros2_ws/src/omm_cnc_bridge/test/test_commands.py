"""What the node has a real LinuxCNC do, and does not have it do, over DDS."""

import math
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")
pytest.importorskip("omm_interfaces", reason="the workspace is not built (./omm setup)")

from node_bench import end
from omm_interfaces.msg import SpindleState
from omm_interfaces.srv import Mdi

from omm_cnc_bridge.controls.linuxcnc.cell import LinuxCncCell, is_installed
from omm_ros.conversions import stamp_ns

MACHINE = Path(__file__).parents[1] / "machines" / "three_axis_mill.urdf"
needs_linuxcnc = pytest.mark.skipif(
    not is_installed(), reason="LinuxCNC is not installed (apt-get install linuxcnc-uspace)"
)


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    with LinuxCncCell("three_axis_mill", tmp_path_factory.mktemp("linuxcnc")) as running:
        yield running


def linuxcnc(cell) -> dict[str, object]:
    reader = f"[{', '.join(cell.reader)}]"
    return {"control": "linuxcnc", "machine_file": MACHINE, "linuxcnc_reader": reader}


def connected(bench) -> bool:
    return bool(bench.states) and bench.states[-1].mode != 0 and len(bench.poses) > 0


@needs_linuxcnc
def test_blocks_are_carried_out_and_answered_when_done(cell, bench, start_node):
    start_node(**linuxcnc(cell), allow_commands=True, mdi_timeout_s=3.0)
    assert bench.spin(20.0, lambda: connected(bench))
    answer = bench.mdi("G53 G1 F3000 X30 Y0 Z0")
    assert (answer.success, answer.message) == (True, "done")
    # Answered when the command has arrived: what is told of later moments is at the end.
    answered_ns = time.time_ns()
    assert bench.spin(5.0, lambda: stamp_ns(bench.states[-1].header.stamp) > answered_ns)
    first = next(s for s in bench.states if stamp_ns(s.header.stamp) > answered_ns)
    assert first.axis_commanded[0] == pytest.approx(0.03, abs=1e-6)
    answer = bench.mdi("G53 G1 X99999")
    assert not answer.success
    assert "would exceed X's positive limit" in answer.message
    answer = bench.mdi("NONSENSE")
    assert not answer.success
    assert "Bad" in answer.message
    assert "limit" not in answer.message  # of the block before
    answer = bench.mdi("G53 G1 F300 X60")  # takes 6 s
    assert (answer.success, "not done within 3 s" in answer.message) == (False, True)
    assert "another block runs" in bench.mdi("G53 G1 X0").message
    for refused in ("", "G0 X1\nG0 X2"):
        assert "expected one block" in bench.mdi(refused).message
    assert bench.spin(10.0, lambda: bench.states[-1].axis_positions[0] > 0.0599)


@needs_linuxcnc
def test_the_spindles_orientation_is_told(cell, bench, start_node):
    start_node(**linuxcnc(cell), allow_commands=True)
    assert bench.spin(20.0, lambda: connected(bench))

    def told() -> tuple[int, float]:
        return bench.states[-1].spindle_orientation, bench.states[-1].spindle_angle

    for degrees in (30.0, 0.0):
        assert bench.mdi("M5").success
        assert bench.spin(3.0, lambda: told()[0] == SpindleState.ORIENTATION_FREE)
        assert math.isnan(told()[1])
        bench.states.clear()
        assert bench.mdi(f"M19 R{degrees:g} Q2").success
        held = (SpindleState.ORIENTATION_HELD, pytest.approx(math.radians(degrees)))
        assert bench.spin(3.0, lambda: bool(bench.states) and told() == held)  # noqa: B023
        assert SpindleState.ORIENTATION_TURNING in {s.spindle_orientation for s in bench.states}
    assert bench.mdi("M5").success
    cell.run(["halcmd", "setp", "spindle.0.orient-fault", "7"])
    try:
        assert "fault 7" in bench.mdi("M19 R60 Q2").message
        assert bench.spin(3.0, lambda: told()[0] == SpindleState.ORIENTATION_FAULT)
        assert math.isnan(told()[1])
    finally:
        cell.run(["halcmd", "setp", "spindle.0.orient-fault", "0"])


@needs_linuxcnc
def test_nothing_is_done_where_commands_are_not_allowed(cell, bench, start_node):
    start_node(**linuxcnc(cell))
    assert bench.spin(20.0, lambda: connected(bench))
    before = bench.states[-1]
    for answer in (bench.mdi("G53 G1 F3000 X1"), bench.call("/cnc_bridge/start_program")):
        assert not answer.success
        assert "allow_commands" in answer.message
    bench.spin(1.0)
    after = bench.states[-1]
    assert (after.mode, after.program_state) == (before.mode, before.program_state)
    assert list(after.axis_commanded) == list(before.axis_commanded)


@needs_linuxcnc
def test_ctrl_c_does_not_wait_for_a_block(cell, bench, start_node):
    process = start_node(**linuxcnc(cell), allow_commands=True)
    assert bench.spin(20.0, lambda: connected(bench))
    bench.wait_for(bench.send(Mdi, "/cnc_bridge/mdi", Mdi.Request(command="G53 G0 X0")))
    bench.send(Mdi, "/cnc_bridge/mdi", Mdi.Request(command="G53 G1 F600 X100"))
    assert bench.spin(5.0, lambda: bench.states[-1].axis_positions[0] > 0.001)
    end(process)


def test_a_control_that_takes_no_blocks_says_so(bench, start_node):
    start_node(control="simulated", allow_commands=True)
    answer = bench.mdi("G0 X0")
    assert not answer.success
    assert "control simulated takes no blocks" in answer.message
    assert bench.spin(5.0, lambda: bench.states)
    assert bench.states[-1].spindle_orientation == SpindleState.ORIENTATION_UNKNOWN
    assert math.isnan(bench.states[-1].spindle_angle)
