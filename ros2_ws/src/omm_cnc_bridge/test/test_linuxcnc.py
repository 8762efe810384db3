"""The bridge against a real LinuxCNC (headless, simulated drives), its hazards included."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from omm_cnc_bridge.control import ControlSample, ProgramState
from omm_cnc_bridge.controls.linuxcnc.cell import LinuxCncCell, is_installed
from omm_cnc_bridge.controls.linuxcnc.control import LOCAL_READER, LinuxCncControl
from omm_cnc_bridge.controls.linuxcnc.simulated import SimulatedLinuxCnc
from omm_cnc_bridge.judgement import Judge, SampleLimits
from omm_cnc_bridge.standstill import StandStillLimits
from omm_core.errors import DeviceError
from omm_core.machine.kinematics import Kinematics
from omm_core.machine.urdf import load_urdf
from omm_core.planning.linuxcnc_program import linuxcnc_program
from omm_core.planning.pattern import Stop, backing_off
from omm_core.planning.program import ProgramOptions, make_program

pytestmark = pytest.mark.skipif(
    not is_installed(), reason="LinuxCNC is not installed (apt-get install linuxcnc-uspace)"
)
MACHINES = Path(__file__).parents[1] / "machines"


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("linuxcnc")
    # As on a machine: for all to see, so that the reader finds it by itself.
    with LinuxCncCell("three_axis_mill", folder, isolated=False) as running:
        yield running


@pytest.fixture
def control(cell):
    made = LinuxCncControl(rate_hz=100)
    made.connect()
    yield made
    made.close()


def read(control, seconds: float, until: Callable[[ControlSample], bool] = lambda s: False):
    """Samples for some time, or until one fulfils a condition."""
    samples: list[ControlSample] = []
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        for sample in control.read(0.05):
            samples.append(sample)
            if until(sample):
                return samples
    return samples


def mdi(control, text: str) -> list[ControlSample]:
    """Have a block done from another thread, as the node does; what was read meanwhile."""
    thread = threading.Thread(target=control.mdi, args=(text,))
    thread.start()
    samples: list[ControlSample] = []
    while thread.is_alive():
        samples += control.read(0.02)
    return samples


def is_settled(sample: ControlSample) -> bool:
    return sample.stamp_uncertainty_ns < 5_000_000


@pytest.mark.parametrize("poll", [False, True])
def test_samples_come_at_the_rate_with_stamps_that_are_true(cell, poll):
    control = LinuxCncControl(rate_hz=100, poll=poll)
    control.connect()
    try:
        read(control, 3.0)
        samples = read(control, 2.0)
        now_ns = time.time_ns()
    finally:
        control.close()
    assert len(samples) > 150
    stamps = np.array([s.stamp_ns for s in samples])
    steps_ms = np.diff(stamps) / 1e6
    assert np.median(steps_ms) == pytest.approx(10.0, abs=0.5)
    assert np.all(steps_ms > 0)
    assert 0 < now_ns - stamps[-1] < 200_000_000
    assert is_settled(samples[-1])


def test_in_position_comes_before_the_axis_has_arrived_and_the_bridge_waits(control):
    """The reason for the three conditions: LinuxCNC's own word follows its command."""
    read(control, 3.0, is_settled)
    mdi(control, "G53 G1 F10000 X0 Y0 Z100")
    read(control, 1.0)
    samples = mdi(control, "G53 G1 F10000 X50 Y0 Z100")
    samples += read(control, 2.0)
    judge = Judge(
        Kinematics.load(MACHINES / "three_axis_mill.urdf"),
        StandStillLimits(tolerance_mm=0.005, dwell_ns=200_000_000),
        SampleLimits(),
    )
    judged = [judge.judge(s, s.stamp_ns) for s in samples]
    last_move = max(i for i, s in enumerate(samples) if not s.in_position)
    says_so = samples[last_move + 1]
    truly = next(j.sample for j in judged[last_move:] if not j.moving_reason)
    assert abs(says_so.positions["X"] - 50.0) > 0.05
    assert abs(truly.positions["X"] - 50.0) < 0.005
    assert truly.stamp_ns - says_so.stamp_ns >= 200_000_000


def test_what_is_told_is_the_machines_whatever_offset_is_active(control):
    """G53 to one place under each: the joints are there, and the tool point's numbers are not."""
    read(control, 3.0, is_settled)
    for active in ("G43.1 Z25", "G92 X1 Y2 Z3", "G52 X7", "G10 L2 P1 X5 Y6 Z7 R30"):
        mdi(control, active)
        mdi(control, "G53 G0 X0 Y0 Z100")
        mdi(control, "G53 G0 X20 Y10 Z100")
        last = read(control, 1.0)[-1]
        assert [last.positions[axis] for axis in "XYZ"] == pytest.approx([20, 10, 100], abs=0.005)
    for cleared in ("G49", "G92.1", "G10 L2 P1 X0 Y0 Z0 R0"):
        mdi(control, cleared)


def test_measuring_program_is_answered_and_runs_to_its_end(cell):
    stops = [
        Stop(target_id=i // 2, spindle_in_machine_mm=np.array([20.0 * i, 10.0 * i, 50.0]))
        for i in range(4)
    ]
    program = cell.folder / "measure.ngc"
    machine = Kinematics.load(MACHINES / "three_axis_mill.urdf")
    gone_to = backing_off(stops, np.array([0.0, 0.0, 10.0]))
    text = linuxcnc_program(make_program(machine, gone_to, ProgramOptions(retract_mm=10.0)))
    program.write_text(text)
    control = LinuxCncControl(rate_hz=100, program_file=str(program))
    control.connect()
    try:
        starting = threading.Thread(target=control.start_program)
        starting.start()
        asked: list[int] = []
        deadline = time.monotonic() + 40
        state = ProgramState.UNKNOWN
        while state is not ProgramState.FINISHED and time.monotonic() < deadline:
            for sample in control.read(0.05):
                state = sample.program_state if asked else state
                request = sample.measure_request
                if request is not None and request not in asked:
                    asked.append(request)
                    at = [sample.positions[a] for a in "XYZ"]
                    np.testing.assert_allclose(
                        at, stops[request - 1].spindle_in_machine_mm, atol=0.01
                    )
                    control.acknowledge(request)
        starting.join()
    finally:
        control.close()
    assert asked == [1, 2, 3, 4]
    assert state is ProgramState.FINISHED


def test_bridge_killed_under_linuxcnc_leaves_it_whole(cell):
    """A reader that dies, however, takes nothing of LinuxCNC with it."""
    for how in (signal.SIGKILL, signal.SIGTERM, None):
        control = LinuxCncControl(rate_hz=100)
        control.connect()
        assert read(control, 3.0, lambda s: True)
        if how is not None:
            os.kill(control._child.pid, how)
        control.close()
    control = LinuxCncControl(rate_hz=100)
    control.connect()
    try:
        assert len(read(control, 2.0)) > 50
        mdi(control, "G53 G1 F10000 X1 Y0 Z100")
        assert read(control, 5.0, lambda s: abs(s.positions["X"] - 1) < 0.01)
    finally:
        control.close()


def test_a_motion_thread_that_stands_still_is_noticed(cell):
    """What would otherwise be the last position, for ever, with fresh stamps."""
    for poll in (False, True):
        control = LinuxCncControl(rate_hz=100, poll=poll)
        control.connect()
        assert read(control, 3.0, lambda s: True)
        (pid,) = cell.pids("rtapi_app")
        os.kill(pid, signal.SIGSTOP)
        stopped_ns = time.time_ns()
        try:
            with pytest.raises(DeviceError, match="rtapi_app is no longer running"):
                read(control, 5.0)
            noticed_ns = time.time_ns()
        finally:
            os.kill(pid, signal.SIGCONT)
            control.close()
        assert noticed_ns - stopped_ns < 1_500_000_000


RELAY = """
import os, subprocess, sys, threading
child = subprocess.Popen(sys.argv[1:], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
def pump(source, sink):
    while data := os.read(source, 65536):
        os.write(sink, data)
    os.close(sink)
threading.Thread(target=pump, args=(0, child.stdin.fileno()), daemon=True).start()
pump(child.stdout.fileno(), 1)
"""


def test_network_gone_and_back_never_makes_old_poses_fresh(cell):
    """The reader behind a relay (as behind ssh) that hangs for 1.5 s, then delivers everything."""
    control = LinuxCncControl(
        rate_hz=100, reader=[sys.executable, "-I", "-c", RELAY, *LOCAL_READER]
    )
    control.connect()
    try:
        before = read(control, 4.0)
        relay = control._child.pid
        os.kill(relay, signal.SIGSTOP)
        gone_ns = time.time_ns()
        silent = read(control, 1.5)
        os.kill(relay, signal.SIGCONT)
        back_ns = time.time_ns()
        after = read(control, 2.0)
    finally:
        control.close()
    assert is_settled(before[-1])
    assert len(silent) <= 3
    # What was made in the meantime comes late and says so: no stamp is later than its making.
    late = [s for s in after if s.stamp_ns < back_ns - 20_000_000]
    assert len(late) > 100
    assert min(s.stamp_ns for s in late) < gone_ns + 100_000_000
    judge = Judge(
        Kinematics.load(MACHINES / "three_axis_mill.urdf"), StandStillLimits(), SampleLimits()
    )
    judged = [judge.judge(s, back_ns) for s in late]
    old = [j for j in judged if j.age_ns > 500_000_000]
    assert old
    assert all(j.machine_T_spindle is None for j in old)


def test_restart_under_the_bridge_is_noticed_and_survived(cell):
    control = LinuxCncControl(rate_hz=100)
    control.connect()
    read(control, 3.0, is_settled)
    cell.stop()
    stopped_ns = time.time_ns()
    with pytest.raises(DeviceError):
        read(control, 5.0, lambda s: s.stamp_ns > stopped_ns)
    control.close()
    with pytest.raises(DeviceError, match="no LinuxCNC runs"):
        control.connect()
    cell.start()
    control.connect()
    try:
        samples = read(control, 3.0)
        assert len(samples) > 100
        assert samples[-1].stamp_ns > stopped_ns
        mdi(control, "G53 G1 F10000 X2 Y0 Z100")
        assert read(control, 5.0, lambda s: abs(s.positions["X"] - 2) < 0.01)
    finally:
        control.close()


def test_truth_comes_at_250_hz(cell):
    machine = Kinematics.load(MACHINES / "three_axis_mill.urdf")
    control = SimulatedLinuxCnc(machine, rate_hz=100)
    control.connect()
    try:
        read(control, 2.0)
        control.read_truth()
        read(control, 2.0)
        truth = control.read_truth()
    finally:
        control.close()
    assert len(truth) >= 400
    assert np.all(np.diff([t.stamp_ns for t in truth]) > 0)


def test_reader_ends_with_a_reason_where_no_linuxcnc_module_is(cell):
    done = subprocess.run(
        [sys.executable, "-I", LOCAL_READER[-1], "--python-path", "/nowhere"],
        capture_output=True,
        text=True,
        timeout=10,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert "lost" in done.stdout


def test_spindle_of_the_urdf_equals_5axiskins(tmp_path):
    """LinuxCNC's own tool centre point against ours, at several poses of head and quill."""
    with LinuxCncCell("bc_head", tmp_path) as cell:
        compared = _compare_with_5axiskins(cell)
    assert len(compared) == 5
    assert max(compared) < 1e-9


def _compare_with_5axiskins(cell: LinuxCncCell) -> list[float]:
    """Largest difference of tool points at each pose, mm."""
    shutil.copy(Path(__file__).with_name("linuxcnc_poses.py"), cell.folder)
    done = cell.run(["/usr/bin/python3", "-I", str(cell.folder / "linuxcnc_poses.py")])
    assert done.returncode == 0, done.stderr
    machine = Kinematics(load_urdf(MACHINES / "linuxcnc_bc_head.urdf"))
    differences = []
    for line in done.stdout.splitlines():
        values = [float(word) for word in line.split()]
        joints, tool_point = values[:6], values[6:]
        axes = dict(zip("XYZ", joints[:3])) | {
            "B": np.radians(joints[3]), "C": np.radians(joints[4]), "W": joints[5]
        }  # fmt: skip
        pose = machine.machine_T_spindle(axes)
        differences.append(float(np.abs(pose.translation_mm - tool_point).max()))
    return differences
