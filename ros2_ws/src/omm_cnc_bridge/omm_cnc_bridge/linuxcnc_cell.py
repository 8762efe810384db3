"""Starts a real LinuxCNC with simulated drives, headless: for the demo, the tests and the bench.

Only one LinuxCNC runs on a machine (its memory and ports are fixed), and its NML ports are open to
the network while it runs: these configurations are for trying, on a machine of one's own.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from omm_cnc_bridge.kinematics import Machine
from omm_cnc_bridge.linuxcnc import SimulatedLinuxCnc
from omm_core.errors import DeviceError

CONFIGURATIONS = ("three_axis_mill", "bc_head")
START_TIMEOUT_S = 20.0
_NOBODY = 65534

# Run by LinuxCNC's own Python in a child that never ends normally (see linuxcnc_reader.py).
_SWITCH_ON = """
import os, sys, time
sys.path.append("/usr/lib/python3/dist-packages")
import linuxcnc
c, s = linuxcnc.command(), linuxcnc.stat()
c.state(linuxcnc.STATE_ESTOP_RESET); c.wait_complete(5)
c.state(linuxcnc.STATE_ON); c.wait_complete(5)
c.mode(linuxcnc.MODE_MANUAL); c.wait_complete(5)
c.home(-1)
end = time.monotonic() + 10
while time.monotonic() < end:
    s.poll()
    if all(s.homed[:s.joints]):
        c.mode(linuxcnc.MODE_MDI); c.wait_complete(5)
        os._exit(0)
    time.sleep(0.02)
os._exit(1)
"""


def configuration_folder() -> Path:
    """Where the ini and hal files are: beside the sources, or in the installed share folder."""
    beside_sources = Path(__file__).resolve().parent.parent / "linuxcnc"
    if beside_sources.is_dir():
        return beside_sources
    from ament_index_python.packages import get_package_share_directory

    return Path(get_package_share_directory("omm_cnc_bridge")) / "linuxcnc"


def is_installed() -> bool:
    """Whether LinuxCNC is on this machine."""
    return shutil.which("linuxcnc") is not None


class LinuxCncCell:
    """A running LinuxCNC; to be used in a ``with`` statement.

    Parameters
    ----------
    configuration : str
        One of CONFIGURATIONS.
    folder : Path
        Gets a copy of the configuration, LinuxCNC's own files and its output.
    """

    def __init__(self, configuration: str, folder: Path) -> None:
        self.folder = folder
        self._ini = folder / f"{configuration}.ini"
        self._process: subprocess.Popen[bytes] | None = None
        self._fifo: tempfile.TemporaryDirectory[str] | None = None
        folder.mkdir(parents=True, exist_ok=True)
        for file in configuration_folder().iterdir():
            shutil.copy(file, folder)
        (folder / "linuxcnc.var").touch()

    def __enter__(self) -> LinuxCncCell:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def start(self) -> None:
        """Start LinuxCNC, switch the machine on and reference it. Raises DeviceError."""
        if not is_installed():
            raise DeviceError(
                "Expected LinuxCNC, found none. On Debian: apt-get install "
                "--no-install-recommends linuxcnc-uspace."
            )
        if _status_memory_exists():
            raise DeviceError("Another LinuxCNC runs on this machine; only one can.")
        with open(self.folder / "output.txt", "ab") as output:
            self._process = subprocess.Popen(
                ["linuxcnc", "-r", str(self._ini)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                cwd=self.folder,
                env=self._environment(),
                start_new_session=True,
            )
        self._switch_on()

    def stop(self) -> None:
        """End LinuxCNC as closing its screen does; its own script then cleans up."""
        process, self._process = self._process, None
        if process is None:
            return
        for pid in self.pids("stay_alive.sh"):
            os.kill(pid, signal.SIGTERM)
        try:
            process.wait(15.0)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        if self._fifo is not None:
            self._fifo.cleanup()
            self._fifo = None

    def pids(self, name: str) -> list[int]:
        """Processes of this LinuxCNC by name: milltask, rtapi_app, stay_alive.sh."""
        found = []
        for entry in Path("/proc").iterdir():
            try:
                if not entry.name.isdigit():
                    continue
                start, _, end = (entry / "stat").read_text().rpartition(")")
                if start.split("(", 1)[1] == name and end.split()[0] != "Z":
                    found.append(int(entry.name))
            except OSError:
                continue  # it ended while we looked
        return found

    def _environment(self) -> dict[str, str]:
        environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "PYTHONPATH")}
        environment.pop("LD_LIBRARY_PATH", None)  # of ROS; LinuxCNC takes the system's
        environment["HOME"] = str(self.folder)
        if os.getuid() == 0:  # as root, LinuxCNC's realtime part runs as another user
            if self._fifo is None:
                self._fifo = tempfile.TemporaryDirectory(prefix="omm_rtapi_")
                os.chown(self._fifo.name, _NOBODY, -1)
            environment["RTAPI_UID"] = str(_NOBODY)
            environment["RTAPI_FIFO_PATH"] = f"{self._fifo.name}/rtapi_fifo"
        return environment

    def _switch_on(self) -> None:
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            time.sleep(0.2)
            if self._process is None or self._process.poll() is not None:
                break
            if not (_status_memory_exists() and self.pids("milltask")):
                continue
            command = ["/usr/bin/python3", "-c", _SWITCH_ON]
            done = subprocess.run(
                command, env=self._environment(), capture_output=True, timeout=30, check=False
            )
            if done.returncode == 0:
                return
        self.stop()
        raise DeviceError(f"LinuxCNC did not start; see {self.folder / 'output.txt'}.")


class DemoLinuxCnc(SimulatedLinuxCnc):
    """A LinuxCNC that is started with the connection and ended with it, and its program."""

    def __init__(
        self, configuration: str, folder: Path, program: str, machine: Machine, **more: Any
    ) -> None:
        self._cell = LinuxCncCell(configuration, folder)
        program_file = folder / "measure.ngc"
        program_file.write_text(program)
        super().__init__(machine, program_file=str(program_file), **more)

    def connect(self) -> None:
        self._cell.stop()
        self._cell.start()
        super().connect()

    def close(self) -> None:
        super().close()
        self._cell.stop()


def _status_memory_exists() -> bool:
    rows = Path("/proc/sysvipc/shm").read_text().splitlines()
    return any(row.split()[0] == "1002" for row in rows)
