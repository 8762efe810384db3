"""What the bridge listens to, in processes of their own that can be stopped, killed and restarted.

Each moves X by 10 mm/s from 0 on. ``python peers.py opcua|mtconnect PORT`` is such a process.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import node_opcua

from omm_cnc_bridge.controls.linuxcnc.cell import LinuxCncCell

HERE = Path(__file__).parent
THREE_AXES = HERE.parent / "machines" / "three_axis_mill.urdf"
X_Y_B = HERE / "x_y_b.urdf"


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


class Peer:
    """A server in a process; ``parameters`` are the bridge's."""

    parameters: dict[str, Any]

    def __init__(self) -> None:
        self.port = free_port()
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        self._process = subprocess.Popen(self._command(), stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line == "ready\n":
                return
        raise AssertionError("the peer did not start")

    def stop(self) -> None:
        """Without a word to anyone."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()

    def hang(self) -> None:
        assert self._process is not None
        os.kill(self._process.pid, signal.SIGSTOP)

    def _command(self) -> list[str]:
        return [sys.executable, str(HERE / "peers.py"), self._kind, str(self.port)]

    _kind = ""


class OpcUa(Peer):
    """asyncua's server."""

    _kind = "opcua"

    def __init__(self) -> None:
        super().__init__()
        url = f"opc.tcp://127.0.0.1:{self.port}/cnc"
        self.parameters = {"control": "opcua", "opcua_url": url, "machine_file": X_Y_B}


class NodeOpcUa(Peer):
    """node-opcua's server, reporting every change."""

    def __init__(self) -> None:
        super().__init__()
        url = f"opc.tcp://127.0.0.1:{self.port}"
        self.parameters = {"control": "opcua", "opcua_url": url, "machine_file": THREE_AXES}

    def _command(self) -> list[str]:
        return node_opcua.command(self.port, "0")

    def start(self) -> None:
        os.environ.update(node_opcua.environment())
        super().start()


class MtConnect(Peer):
    _kind = "mtconnect"

    def __init__(self) -> None:
        super().__init__()
        url = f"http://127.0.0.1:{self.port}"
        self.parameters = {"control": "mtconnect", "mtconnect_url": url, "machine_file": X_Y_B}


class LinuxCnc:
    """LinuxCNC itself."""

    def __init__(self, folder: Path, *, poll: bool = False) -> None:
        self.cell = LinuxCncCell("three_axis_mill", folder)
        self.parameters: dict[str, Any] = {
            "control": "linuxcnc",
            "machine_file": THREE_AXES,
            "linuxcnc_reader": f"[{', '.join(self.cell.reader)}]",
            "linuxcnc_poll": poll,
        }

    def start(self) -> None:
        self.cell.start()
        move = (
            "import os, sys; sys.path.append('/usr/lib/python3/dist-packages'); import linuxcnc; "
        )
        move += "linuxcnc.command().mdi('G53 G1 F600 X2000'); os._exit(0)"
        assert self.cell.run(["/usr/bin/python3", "-c", move]).returncode == 0

    def stop(self) -> None:
        self.cell.stop()

    def hang(self) -> None:
        for name in ("rtapi_app", "milltask"):
            for pid in self.cell.pids(name):
                os.kill(pid, signal.SIGSTOP)


def serve_opcua(port: int) -> None:
    from opcua_server import OpcUaTestServer

    with OpcUaTestServer(port) as server:
        print("ready", flush=True)
        started = time.monotonic()
        while True:
            time.sleep(0.005)
            server.positions["X"] = server.commanded["X"] = 10.0 * (time.monotonic() - started)


def serve_mtconnect(port: int) -> None:
    from mtconnect_agent import GOOD, Agent

    with Agent(version="2.2", port=port) as agent:
        agent.instance = os.getpid()
        agent.tell(**GOOD)
        print("ready", flush=True)
        started = time.monotonic()
        while True:
            time.sleep(0.01)
            x = 10.0 * (time.monotonic() - started)
            agent.tell(xa=x, xc=x)


class BlackHole:
    """Takes connections and says nothing."""

    def __enter__(self) -> int:
        self._socket = socket.socket()
        self._socket.bind(("127.0.0.1", 0))
        self._socket.listen()
        self._held: list[socket.socket] = []
        threading.Thread(target=self._run, daemon=True).start()
        return int(self._socket.getsockname()[1])

    def __exit__(self, *_: object) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        for held in self._held:
            held.close()

    def _run(self) -> None:
        while True:
            try:
                self._held.append(self._socket.accept()[0])
            except OSError:
                return


if __name__ == "__main__":
    {"opcua": serve_opcua, "mtconnect": serve_mtconnect}[sys.argv[1]](int(sys.argv[2]))
