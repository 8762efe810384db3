"""LinuxCNC as the demo starts it: several at once, and nothing left behind however it ends."""

import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from omm_cnc_bridge.controls.linuxcnc.cell import (
    LinuxCncCell,
    can_isolate,
    is_installed,
    pids_at,
    remove_stale_folders,
)
from omm_cnc_bridge.controls.linuxcnc.control import LinuxCncControl
from omm_cnc_bridge.controls.linuxcnc.demo import DemoLinuxCnc
from omm_core.errors import DeviceError
from omm_core.machine.kinematics import Kinematics

pytestmark = pytest.mark.skipif(
    not is_installed(), reason="LinuxCNC is not installed (apt-get install linuxcnc-uspace)"
)
needs_namespaces = pytest.mark.skipif(
    not can_isolate(), reason="the system does not allow namespaces (unshare)"
)
MACHINE = Path(__file__).parents[1] / "machines" / "three_axis_mill.urdf"

HOLDER = f"""
import time
from omm_cnc_bridge.controls.linuxcnc.demo import DemoLinuxCnc
from omm_core.machine.kinematics import Kinematics
machine = Kinematics.load({str(MACHINE)!r})
control = DemoLinuxCnc("three_axis_mill", "M2", machine, rate_hz=100)
control.connect()
print(control.folder, flush=True)
time.sleep(60)
"""


def x_of(cell: LinuxCncCell, block: str) -> float:
    """Where X is after a block."""
    moved = cell.run(["/usr/bin/python3", "-c", MOVE, block])
    assert moved.returncode == 0, moved.stderr
    control = LinuxCncControl(rate_hz=100, reader=cell.reader)
    control.connect()
    try:
        deadline = time.monotonic() + 5.0
        while not (samples := control.read(0.1)):
            assert time.monotonic() < deadline
        return samples[-1].positions["X"]
    finally:
        control.close()


MOVE = """
import os, sys, time
sys.path.append("/usr/lib/python3/dist-packages")
import linuxcnc
command = linuxcnc.command()
command.mdi(sys.argv[1])
command.wait_complete(10)
time.sleep(0.3)
os._exit(0)
"""


@needs_namespaces
def test_two_run_side_by_side(tmp_path):
    with (
        LinuxCncCell("three_axis_mill", tmp_path / "a") as a,
        LinuxCncCell("three_axis_mill", tmp_path / "b") as b,
    ):
        assert x_of(a, "G53 G0 X11") == pytest.approx(11.0, abs=0.01)
        assert x_of(b, "G53 G0 X22") == pytest.approx(22.0, abs=0.01)
        assert x_of(a, "G4 P0") == pytest.approx(11.0, abs=0.01)
        # A reader outside sees neither.
        outside = LinuxCncControl(rate_hz=100)
        with pytest.raises(DeviceError, match="no LinuxCNC runs here"):
            outside.connect()
        outside.close()


@needs_namespaces
def test_no_port_is_open_to_the_network(tmp_path):
    def open_ports() -> str:
        return Path("/proc/net/tcp").read_text()

    before = open_ports()
    with LinuxCncCell("three_axis_mill", tmp_path):
        assert f":{5005:04X} " not in open_ports() or f":{5005:04X} " in before


def test_without_namespaces_the_second_is_told_who_the_first_is(tmp_path):
    with (
        LinuxCncCell("three_axis_mill", tmp_path / "a", isolated=False),
        pytest.raises(DeviceError, match=re.escape(f"{tmp_path / 'a'}/three_axis_mill.ini")),
    ):
        LinuxCncCell("three_axis_mill", tmp_path / "b", isolated=False).start()


def test_nothing_is_left_when_the_holder_is_killed():
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER], stdout=subprocess.PIPE, text=True
    ) as holder:
        folder = Path(holder.stdout.readline().strip())
        assert pids_at(folder, "milltask")
        remove_stale_folders()
        assert (folder / "measure.ngc").exists()  # its owner lives
        holder.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 20.0
    while pids_at(folder, "milltask") or pids_at(folder, "rtapi_app"):
        assert time.monotonic() < deadline, "LinuxCNC goes on without the one who started it"
        time.sleep(0.1)
    remove_stale_folders()
    assert not folder.exists()


def test_nothing_is_left_after_the_end():
    control = DemoLinuxCnc("three_axis_mill", "M2", Kinematics.load(MACHINE), rate_hz=100)
    control.connect()
    folder = control.folder
    assert folder.parent == Path(tempfile.gettempdir())
    assert folder.is_dir()
    control.close()
    assert not folder.exists()


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_nothing_is_left_when_the_node_is_ended(bench, start_node, how):
    process = start_node(control="linuxcnc", linuxcnc_cell="three_axis_mill", start_program=False)
    assert bench.spin(30.0, lambda: len(bench.poses) > 10)
    (folder,) = Path(tempfile.gettempdir()).glob(f"omm_linuxcnc_{process.pid}_*")
    process.send_signal(how)
    assert process.wait(10.0) == 0, process.stderr.read()
    assert not folder.exists()
