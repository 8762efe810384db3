"""How fast images get from the camera to a subscriber, what they cost, and whether any is lost.

    ./omm exec python bench/camera.py [--driver gige] [--rate 15] [--seconds 60] [--loaded]

A simulated GigE camera (5 MB an image) sends on loopback, the camera node publishes, this process
subscribes. With `--loaded`, the bridge of a simulated control, estimator and recorder run beside,
and what the recording lost or missed is told. CPU time is of the camera node's process.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from omm_ros import transport

transport.prepare()

import rclpy  # noqa: E402
from ament_index_python.packages import get_package_prefix  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.node import Node  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from omm_camera_driver.drivers.gige.simulator import GigeSimulator  # noqa: E402
from omm_recording.reading import Recording  # noqa: E402
from omm_recording.writing import REPORT  # noqa: E402
from omm_ros import qos  # noqa: E402
from omm_ros.conversions import stamp_ns  # noqa: E402
from omm_simulation.cell import draw  # noqa: E402
from omm_simulation.offline import run  # noqa: E402
from omm_simulation.scenario import load_scenario  # noqa: E402

WIDTH, HEIGHT = 2592, 1944
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Measure and print one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, default=15.0, help="images per second")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--loaded", action="store_true", help="with bridge, estimator and recorder")
    parser.add_argument("--camera", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.camera:
        return serve()
    os.environ.setdefault("ROS_DOMAIN_ID", "87")
    with tempfile.TemporaryDirectory() as folder:
        processes = start(args, Path(folder))
        try:
            figures = measure(args, processes["camera_node"].pid)
        finally:
            for process in reversed(processes.values()):
                process.send_signal(signal.SIGINT)
            for process in processes.values():
                process.wait(120)
        if args.loaded:
            figures["recorded"] = recorded(Path(folder) / "run")
    print(json.dumps(figures, indent=1))
    return 0


def serve() -> int:
    """Send an image that is there already, so that what is measured is not its making."""
    image = next(m.image for m in run(draw(load_scenario("bench"), 1)) if hasattr(m, "image"))
    simulator = GigeSimulator(lambda begin_ns, exposure_ns, bits: image, WIDTH, HEIGHT)
    print("ready", flush=True)
    try:
        signal.pause()
    except KeyboardInterrupt:
        simulator.close()
    return 0


def start(args: argparse.Namespace, folder: Path) -> dict[str, "subprocess.Popen[bytes]"]:
    """Camera and nodes as processes."""
    camera = subprocess.Popen([sys.executable, __file__, "--camera"], stdout=subprocess.PIPE)
    assert camera.stdout is not None
    assert camera.stdout.readline() == b"ready\n"
    processes = {"camera": camera}
    scenario = load_scenario("bench")
    files = {"part_file": scenario.part_file, "calibration_file": scenario.calibration_file}
    nodes: list[tuple[str, str, dict[str, object]]] = [
        ("omm_camera_driver", "camera_node", {
            "driver": "gige", "device": "127.0.0.1", "frame_rate_hz": args.rate,
            "calibration_file": scenario.calibration_file,
        }),
    ]  # fmt: skip
    if args.loaded:
        nodes += [
            ("omm_estimator", "estimator_node", dict(files)),
            ("omm_cnc_bridge", "cnc_bridge_node", {"control": "simulated", "scenario": "bench"}),
            ("omm_recorder", "recorder_node", {"folder": folder / "run", **files}),
        ]
    for package, executable, parameters in nodes:
        program = Path(get_package_prefix(package)) / "lib" / package / executable
        given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        processes[executable] = subprocess.Popen([str(program), "--ros-args", *given])
    return processes


class Subscriber(Node):
    """Takes the times of what arrives."""

    def __init__(self) -> None:
        super().__init__("bench")
        self.arrivals: list[tuple[int, int, int]] = []  # exposed, published, here
        self.health: dict[str, str] = {}
        self.received_at_health = 0
        self.create_subscription(Image, "/camera/image_raw", self._on_image, qos.IMAGE)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_image(self, message: Image, info: dict[str, int]) -> None:
        stamp = stamp_ns(message.header.stamp)
        self.arrivals.append((stamp, info["source_timestamp"], time.time_ns()))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "camera: connection":
                self.health = {v.key: v.value for v in status.values}
                self.received_at_health = len(self.arrivals)


def cpu_s(pid: int) -> float:
    """User and system time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def measure(args: argparse.Namespace, pid: int) -> dict[str, object]:
    """Wait for images, then count for the given time."""
    rclpy.init()
    node = Subscriber()
    deadline_s = time.monotonic() + 60.0
    while len(node.arrivals) < 3 * args.rate:
        rclpy.spin_once(node, timeout_sec=0.1)
        if time.monotonic() > deadline_s:
            raise SystemExit("no images")
    published = int(settled_health(node)["published"])
    first = node.received_at_health
    begin_cpu_s, begin_s = cpu_s(pid), time.monotonic()
    while time.monotonic() - begin_s < args.seconds:
        rclpy.spin_once(node, timeout_sec=0.1)
    elapsed_s, used_s = time.monotonic() - begin_s, cpu_s(pid) - begin_cpu_s
    health = settled_health(node)
    arrivals = np.array(node.arrivals[first : node.received_at_health])
    rclpy.shutdown()
    since_exposed_ms, since_published_ms = (arrivals[:, 2:] - arrivals[:, :2]).T / 1e6
    return {
        "rate_asked_hz": args.rate,
        "loaded": args.loaded,
        "seconds": round(elapsed_s, 1),
        "images": len(arrivals),
        "images_per_s": round(1e9 * (len(arrivals) - 1) / np.ptp(arrivals[:, 2]), 2),
        # One or two are on their way when the node is asked.
        "published_and_not_received": int(health["published"]) - published - len(arrivals),
        "incomplete_at_the_camera": int(health["incomplete"]),
        "missing_at_the_camera": int(health["missing"]),
        "published_to_subscriber_ms": percentiles(since_published_ms),
        "middle_of_exposure_to_subscriber_ms": percentiles(since_exposed_ms),
        "camera_node_cpu_ms_per_image": round(1e3 * used_s / len(arrivals), 2),
    }


def recorded(run: Path) -> dict[str, str]:
    """Return the recorder's own account, by the numbers that publishers give their messages."""
    with Recording(run) as recording:
        report = recording.metadata()[REPORT]
    told = {name: json.loads(text) for name, text in report.items() if name.startswith("/")}
    return {
        name: f"{t['recorded']} recorded, {t['lost_by_recorder']} lost here, "
        f"{t['missing_from_publisher']} missing"
        for name, t in told.items()
        if t["received"]
    }


def settled_health(node: Subscriber) -> dict[str, str]:
    """Diagnostics that are fresh."""
    node.health = {}
    while "published" not in node.health:
        rclpy.spin_once(node, timeout_sec=0.1)
    return node.health


def percentiles(values: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> dict[str, float]:
    """Median, 99th percentile and the largest."""
    p50, p99, most = np.percentile(values, [50, 99, 100])
    return {"p50": round(p50, 2), "p99": round(p99, 2), "max": round(most, 2)}


if __name__ == "__main__":
    sys.exit(main())
