"""The CNC bridge as a node: poses per second, how old they are when others have them, cost.

    ./omm exec python bench/cnc.py [--seconds S] [--json OUT]

Each control is in a process of its own and moves X all the time: LinuxCNC itself (where it is
installed), two OPC UA servers (asyncua's; node-opcua's with the CNC nodeset, where it is installed)
and an MTConnect agent. The bridge is a process too; this one subscribes to /cnc/spindle_pose.
"published" is the pose's age (against its own stamp) when the bridge publishes it, as its own
diagnostics tell; "here" its age when it has come here over DDS. What the stamps are worth is told
beside it (median standard deviation that the clock relation admits), and the bridge's processor
time with its children's.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "ros2_ws/src/omm_cnc_bridge/test"))
WARM_UP_S = 5.0
COLUMNS = {
    "poses_per_s": "poses/s",
    "largest_gap_ms": "gap max ms",
    "published_p50_ms": "published p50 ms",
    "published_p99_ms": "p99 ms",
    "here_p50_ms": "here p50 ms",
    "here_p99_ms": "p99 ms",
    "stamp_sigma_ms": "stamp ± ms",
    "cpu_percent": "CPU %",
}


def main() -> int:
    parser = argparse.ArgumentParser(description="Benchmark of the CNC bridge.")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(10 + os.getpid() % 90)
    print(f"{os.cpu_count()} × {_processor()}, load {os.getloadavg()[0]:.1f}, Python "
          f"{platform.python_version()}, {args.seconds:g} s each\n")  # fmt: skip
    print(f"| control | {' | '.join(COLUMNS.values())} |")
    print("|---" * (len(COLUMNS) + 1) + "|")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, make in _controls(Path(folder)).items():
            peer = make()
            if peer is None:
                print(f"| {name} | not installed here |")
                continue
            row = measure(peer, args.seconds)
            rows.append({"control": name, **row})
            print(f"| {name} | {' | '.join(f'{row[key]:.2f}' for key in COLUMNS)} |", flush=True)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")
    return 0


class SimulatedCell:
    """The bridge's own simulated control: no peer is needed."""

    parameters: dict[str, Any] = {"control": "simulated", "repetitions": 100}  # noqa: RUF012

    def start(self) -> None:
        """Nothing to start."""

    def stop(self) -> None:
        """Nothing to stop."""


def _controls(folder: Path) -> dict[str, Callable[[], Any]]:
    import node_opcua
    import peers

    from omm_cnc_bridge.controls.linuxcnc.cell import is_installed

    def linuxcnc(poll: bool) -> Any:
        return peers.LinuxCnc(folder / f"poll_{poll}", poll=poll) if is_installed() else None

    return {
        "simulated": SimulatedCell,
        "LinuxCNC (sampler)": lambda: linuxcnc(False),
        "LinuxCNC (polled)": lambda: linuxcnc(True),
        "OPC UA (asyncua)": peers.OpcUa,
        "OPC UA (node-opcua)": lambda: peers.NodeOpcUa() if node_opcua.is_installed() else None,
        "MTConnect": peers.MtConnect,
    }


def measure(peer: Any, seconds: float) -> dict[str, float]:
    """Run the bridge on a control for some time and hear it."""
    from node_bench import Bench, end, start_bridge

    bench = Bench(int(os.environ["ROS_DOMAIN_ID"]))
    process = None
    try:
        peer.start()
        process = start_bridge(**peer.parameters)
        assert bench.spin(30.0, lambda: len(bench.poses) > 100), "no poses"
        bench.spin(WARM_UP_S)
        for heard in (bench.heard_ns, bench.poses, bench.states):
            heard.clear()
        cpu_s = _cpu_s(process.pid)
        bench.spin(seconds)
        cpu_s = _cpu_s(process.pid) - cpu_s
        poses, heard_ns, states = list(bench.poses), list(bench.heard_ns), list(bench.states)
        published = {v.key: v.value for v in bench.diagnostics["cnc_bridge: poses"].values}
        end(process)
    finally:
        if process is not None and process.poll() is None:
            process.kill()
            process.communicate()
        peer.stop()
        bench.close()
    stamps = np.array([p.header.stamp.sec * 10**9 + p.header.stamp.nanosec for p in poses])
    ages_ms = (np.array(heard_ns) - stamps) / 1e6
    return {
        "poses_per_s": len(stamps) / seconds,
        "largest_gap_ms": float(np.max(np.diff(stamps))) / 1e6,
        "published_p50_ms": float(published["age p50 [ms]"]),
        "published_p99_ms": float(published["age p99 [ms]"]),
        "here_p50_ms": float(np.percentile(ages_ms, 50)),
        "here_p99_ms": float(np.percentile(ages_ms, 99)),
        "stamp_sigma_ms": float(np.median([s.stamp_uncertainty for s in states])) * 1e3,
        "cpu_percent": 100.0 * cpu_s / seconds,
    }


def _cpu_s(pid: int) -> float:
    """Processor time of a process and of those that it started."""
    processes = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it ended while we looked
            words = path.read_text().rpartition(")")[2].split()
            processes[int(path.parent.name)] = (int(words[1]), sum(map(int, words[11:13])))
    family, size = {pid}, 0
    while len(family) > size:
        size = len(family)
        family |= {child for child, (parent, _) in processes.items() if parent in family}
    return sum(processes[p][1] for p in family) / os.sysconf("SC_CLK_TCK")


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((x.split(": ", 1)[1] for x in lines if x.startswith("model name")), "processor")


if __name__ == "__main__":
    sys.exit(main())
