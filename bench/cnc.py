"""The CNC bridge's adapters: rate, age of a sample when the bridge has it, cost.

    ./omm exec python bench/cnc.py [--seconds S] [--json OUT]

Each adapter is heard over a real connection while X moves: LinuxCNC itself (where it is installed),
an OPC UA server (asyncua) and an MTConnect agent, each in a process of its own. The age is that of
the position when it comes out of the adapter: the pose is published some 0.1 ms later. What the
stamps are worth is told beside it (standard deviation that the clock relation admits).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from omm_cnc_bridge.control import Control

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "ros2_ws/src/omm_cnc_bridge/test"))
WARM_UP_S = 5.0


def main() -> int:
    parser = argparse.ArgumentParser(description="Benchmark of the CNC bridge's adapters.")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows = []
    units = ("rate/s", "gap max ms", "age p50 ms", "age p99 ms", "stamp ± ms", "CPU %")
    print(f"{'adapter':<22}" + "".join(f"{unit:>12}" for unit in units))
    for name, adapter in ADAPTERS.items():
        with adapter() as control:
            if control is None:
                print(f"{name:<22}  not installed here")
                continue
            row = measure(control, args.seconds)
        rows.append({"adapter": name, **row})
        print(f"{name:<22}" + "".join(f"{v:>12.2f}" for v in row.values()))
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")
    return 0


def measure(control: Control, seconds: float) -> dict[str, float]:
    """Read for some time; ages against the system clock, which all peers share here."""
    ages, stamps, sigmas = [], [], []
    end = time.monotonic() + WARM_UP_S
    while time.monotonic() < end:
        control.read(0.05)
    end, cpu = time.monotonic() + seconds, time.process_time()
    while time.monotonic() < end:
        samples = control.read(0.05)
        now_ns = time.time_ns()
        ages += [now_ns - s.stamp_ns for s in samples]
        stamps += [s.stamp_ns for s in samples]
        sigmas += [s.stamp_uncertainty_ns for s in samples]
    cpu = time.process_time() - cpu
    return {
        "rate_hz": len(stamps) / seconds,
        "largest_gap_ms": float(np.max(np.diff(stamps))) / 1e6,
        "age_p50_ms": float(np.percentile(ages, 50)) / 1e6,
        "age_p99_ms": float(np.percentile(ages, 99)) / 1e6,
        "stamp_sigma_ms": float(np.median(sigmas)) / 1e6,
        "cpu_percent": 100.0 * cpu / seconds,
    }


@contextlib.contextmanager
def connected(control: Control) -> Iterator[Control]:
    control.connect()
    try:
        yield control
    finally:
        control.close()


@contextlib.contextmanager
def simulated() -> Iterator[Control]:
    from omm_cnc_bridge.simulated import SimulatedCellControl
    from omm_simulation.cell import draw
    from omm_simulation.scenario import load_scenario

    made = SimulatedCellControl(draw(load_scenario("bench"), 1), rate_hz=100)
    with connected(made) as control:
        made.start_program()
        yield control


@contextlib.contextmanager
def linuxcnc(poll: bool) -> Iterator[Control | None]:
    from omm_cnc_bridge.linuxcnc import LinuxCncControl
    from omm_cnc_bridge.linuxcnc_cell import LinuxCncCell, is_installed

    if not is_installed():
        yield None
        return
    with tempfile.TemporaryDirectory() as folder, LinuxCncCell("three_axis_mill", Path(folder)):
        made = LinuxCncControl(rate_hz=100, poll=poll)
        with connected(made) as control:
            threading.Thread(target=_move_slowly, args=(made,), daemon=True).start()
            yield control


def _move_slowly(control) -> None:  # type: ignore[no-untyped-def]
    control.mdi("G53 G1 F1200 X2000 Y0 Z0")  # 20 mm/s for longer than any run


@contextlib.contextmanager
def in_process(target, *arguments) -> Iterator[None]:  # type: ignore[no-untyped-def]
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    process = context.Process(target=target, args=(ready, *arguments), daemon=True)
    process.start()
    try:
        assert ready.wait(60.0), "the server did not start"
        yield
    finally:
        process.terminate()
        process.join()


def serve_opcua(ready, port: int) -> None:  # type: ignore[no-untyped-def]
    from opcua_server import OpcUaTestServer  # type: ignore[import-not-found]

    with OpcUaTestServer(port) as server:
        ready.set()
        while True:
            time.sleep(0.005)
            for values in (server.positions, server.commanded):
                values["X"] += 0.1


def serve_mtconnect(ready, port: int) -> None:  # type: ignore[no-untyped-def]
    from mtconnect_agent import GOOD, Agent  # type: ignore[import-not-found]

    with Agent(version="2.2", port=port) as agent:
        agent.tell(**GOOD)
        ready.set()
        x = 0.0
        while True:
            time.sleep(0.01)
            x += 0.1
            agent.tell(xa=x, xc=x)


@contextlib.contextmanager
def opcua() -> Iterator[Control]:
    from omm_cnc_bridge.opcua import OpcUaControl

    port = _free_port()
    with in_process(serve_opcua, port):
        made = OpcUaControl(f"opc.tcp://127.0.0.1:{port}/cnc", rate_hz=100)
        with connected(made) as control:
            yield control


@contextlib.contextmanager
def mtconnect() -> Iterator[Control]:
    from omm_cnc_bridge.mtconnect import MtConnectControl

    port = _free_port()
    with in_process(serve_mtconnect, port):
        made = MtConnectControl(f"http://127.0.0.1:{port}", rate_hz=100)
        with connected(made) as control:
            yield control


def _free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


ADAPTERS = {
    "simulated": simulated,
    "linuxcnc (sampler)": lambda: linuxcnc(poll=False),
    "linuxcnc (polled)": lambda: linuxcnc(poll=True),
    "opcua": opcua,
    "mtconnect": mtconnect,
}

if __name__ == "__main__":
    sys.exit(main())
