"""Starts a real LinuxCNC with simulated drives, headless: for the demo, the tests and the bench.

A LinuxCNC's memory, lock and ports are the same for all: only one runs on a machine, and its NML
ports are open to the network. Where the system allows it, this one therefore gets namespaces of its
own (see unshare(1)): several run side by side, no port is open, and nothing is left behind.
"""

from __future__ import annotations

import functools
import os
import shlex
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from omm_cnc_bridge.controls.linuxcnc.control import LOCAL_READER
from omm_core.errors import DeviceError

START_TIMEOUT_S = 20.0
_NOBODY = 65534
FOLDER_PREFIX = "omm_linuxcnc_"
_NAMESPACES = ("--mount", "--ipc", "--net", "--pid")

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
    """Return the folder of the ini and hal files: beside the sources, or installed."""
    beside_sources = Path(__file__).resolve().parents[3] / "linuxcnc"
    if beside_sources.is_dir():
        return beside_sources
    from ament_index_python.packages import get_package_share_directory

    return Path(get_package_share_directory("omm_cnc_bridge")) / "linuxcnc"


def is_installed() -> bool:
    """Return whether LinuxCNC is on this machine."""
    return shutil.which("linuxcnc") is not None


@functools.cache
def can_isolate() -> bool:
    """Return whether this system lets us give LinuxCNC namespaces of its own."""
    if not all(shutil.which(tool) for tool in ("unshare", "nsenter", "ip")):
        return False
    trial = [*_unshare(), "ip", "link", "set", "lo", "up"]
    return subprocess.run(trial, capture_output=True, check=False).returncode == 0


def _unshare() -> list[str]:
    user = [] if os.getuid() == 0 else ["--user", "--map-root-user"]
    return ["unshare", *user, *_NAMESPACES, "--fork", "--kill-child", "--mount-proc"]


def _ourselves() -> list[str]:
    """Return the words that make a command run as the user again.

    Mounting needs root in there; what then runs must not be root.
    """
    return ["unshare", "--user", f"--map-user={os.getuid()}", f"--map-group={os.getgid()}"]


class LinuxCncCell:
    """A running LinuxCNC; to be used in a ``with`` statement.

    Parameters
    ----------
    configuration : str
        ``three_axis_mill`` or ``bc_head``: a folder of `configuration_folder`.
    folder : Path
        Gets a copy of the configuration, LinuxCNC's own files and its output. What LinuxCNC is to
        read, such as programs, must be in there.
    isolated : bool, optional
        Whether it gets namespaces of its own; None where that is possible.
    """

    def __init__(self, configuration: str, folder: Path, *, isolated: bool | None = None) -> None:
        self.folder = folder
        self.isolated = can_isolate() if isolated is None else isolated
        self._ini = folder / f"{configuration}.ini"
        self._process: subprocess.Popen[bytes] | None = None
        self._fifo: tempfile.TemporaryDirectory[str] | None = None
        folder.mkdir(parents=True, exist_ok=True)
        for file in configuration_folder().iterdir():
            shutil.copy(file, folder)
        shutil.copy(LOCAL_READER[-1], folder)
        (folder / "linuxcnc.var").touch()
        self._write_reader()

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

    @property
    def reader(self) -> tuple[str, ...]:
        """Command that reads this LinuxCNC, also after it was started anew."""
        return ("/bin/sh", str(self.folder / "reader.sh"))

    def start(self) -> None:
        """Start LinuxCNC, switch the machine on and reference it. Raises DeviceError."""
        if not is_installed():
            raise DeviceError(
                "Expected LinuxCNC, found none. On Debian: apt-get install "
                "--no-install-recommends linuxcnc-uspace."
            )
        if not self.isolated and _status_memory_exists():
            raise DeviceError(
                f"Another LinuxCNC runs on this machine ({_other_linuxcnc()}); only one can where "
                "the system does not allow namespaces (unshare)."
            )
        self._process = subprocess.Popen(
            self._command(),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=self.folder,
            env=self._environment(),
            start_new_session=True,
        )
        self._switch_on()
        self._write_reader()

    def stop(self) -> None:
        """End LinuxCNC as closing its screen does; its own script then cleans up."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        process.stdin.close()
        try:
            process.wait(1.5 if self.isolated else 15.0)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # namespaces and all that is in them go with it
            process.wait()
        if self._fifo is not None:
            self._fifo.cleanup()
            self._fifo = None
        self._write_reader()

    def run(self, command: Sequence[str]) -> subprocess.CompletedProcess[str]:
        """Run a command beside LinuxCNC, for instance halcmd."""
        return subprocess.run(
            [*self._enter(), *command],
            env=self._environment(),
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    def pids(self, name: str) -> list[int]:
        """Return this LinuxCNC's processes by name: milltask, rtapi_app, stay_alive.sh."""
        return pids_at(self.folder, name)

    def _command(self) -> list[str]:
        start = ["/bin/sh", str(self.folder / "start.sh"), str(self._ini)]
        linuxcnc = ["linuxcnc", "-r", str(self._ini)]
        if not self.isolated:
            return [*start, *linuxcnc]
        if os.getuid() == 0:
            return [*_unshare(), *start, *linuxcnc]
        return [*_unshare(), *start, *_ourselves(), *linuxcnc]

    def _enter(self) -> list[str]:
        """Return the words before a command that make it run where LinuxCNC does."""
        pids = self.pids("sh")
        if not (self.isolated and pids):
            return []
        enter = ["nsenter", f"--target={min(pids)}", *_NAMESPACES]
        if os.getuid() == 0:
            return enter
        return [*enter, "--user", "--preserve-credentials"]

    def _write_reader(self) -> None:
        """Write the command that runs the reader.

        It is a file, because every start has other namespaces to enter.
        """
        read = [*self._enter(), *LOCAL_READER[:-1], str(self.folder / Path(LOCAL_READER[-1]).name)]
        (self.folder / "reader.sh").write_text(f'exec {shlex.join(read)} "$@"\n')

    def _environment(self) -> dict[str, str]:
        environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "PYTHONPATH")}
        environment.pop("LD_LIBRARY_PATH", None)  # of ROS; LinuxCNC takes the system's
        environment["HOME"] = str(self.folder)
        if self.isolated:
            environment["omm_own_tmp"] = "1"
        if os.getuid() == 0:  # as root, LinuxCNC's realtime part runs as another user
            environment["RTAPI_UID"] = str(_NOBODY)
            environment["RTAPI_FIFO_PATH"] = f"{self._fifo_folder()}/rtapi_fifo"
        return environment

    def _fifo_folder(self) -> str:
        """Return a folder that the other user may write to."""
        if self.isolated:
            return "/tmp"
        if self._fifo is None:
            self._fifo = tempfile.TemporaryDirectory(prefix="omm_rtapi_")
            os.chown(self._fifo.name, _NOBODY, -1)
        return self._fifo.name

    def _switch_on(self) -> None:
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            time.sleep(0.2)
            if self._process is None or self._process.poll() is not None:
                break
            if not self.pids("milltask") or not (self.isolated or _status_memory_exists()):
                continue
            if self.run(["/usr/bin/python3", "-I", "-c", _SWITCH_ON]).returncode == 0:
                return
        self.stop()
        output = (self.folder / "output.txt").read_text(errors="replace")
        raise DeviceError(f"LinuxCNC did not start; it says: {output[-1000:].strip()}")


def pids_at(folder: Path, name: str) -> list[int]:
    """Return the processes, by name, of the LinuxCNC that lives in a folder."""
    home = f"HOME={folder}".encode()
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if not entry.name.isdigit() or (entry / "comm").read_text().strip() != name:
                continue
            if home in (entry / "environ").read_bytes().split(b"\0"):
                found.append(int(entry.name))
        except OSError:
            continue  # it ended while we looked, or is another user's
    return found


def remove_stale_folders() -> None:
    """Remove what demos left behind that were killed; their process is in the folder's name."""
    for folder in Path(tempfile.gettempdir()).glob(f"{FOLDER_PREFIX}[0-9]*_*"):
        pid = folder.name.removeprefix(FOLDER_PREFIX).split("_")[0]
        if not Path("/proc", pid).exists():
            shutil.rmtree(folder, ignore_errors=True)


def _status_memory_exists() -> bool:
    rows = Path("/proc/sysvipc/shm").read_text().splitlines()
    return any(row.split()[0] == "1002" for row in rows)


def _other_linuxcnc() -> str:
    """Return what holds the memory that every LinuxCNC uses, in words."""
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and (entry / "comm").read_text().strip() == "milltask":
                words = (entry / "cmdline").read_bytes().split(b"\0")
                return f"process {entry.name}: {b' '.join(words).decode(errors='replace').strip()}"
        except OSError:
            continue  # it ended while we looked
    return "it has gone without removing its shared memory 1002: ipcrm -M 1002"
