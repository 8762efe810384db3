"""How soon after an image the estimate is published, with the recorder running.

    ./omm exec python bench/estimator.py [--clampings 5] [--bumped]

A run of the simulated bench is published at its own pace, several times over; estimator and
recorder are processes of their own. An image's first estimate comes as soon as its targets are
found; its last one when the spindle has demonstrably stood still for some time after it. With
`--bumped`, a target is not where the part file says: the estimator searches for what is wrong.
"""

import argparse
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
from geometry_msgs.msg import PoseStamped  # noqa: E402
from omm_interfaces.msg import PartEstimate  # noqa: E402
from rclpy.node import Node  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from omm_core.files.part import load_part  # noqa: E402
from omm_ros import qos  # noqa: E402
from omm_ros.conversions import (  # noqa: E402
    image_message,
    pose_from_transform,
    stamp_ns,
    time_from_ns,
)
from omm_simulation.cell import draw, write_estimator_files  # noqa: E402
from omm_simulation.offline import ImageMessage, run  # noqa: E402
from omm_simulation.scenario import load_scenario  # noqa: E402


class Machine(Node):
    """Publishes a run and takes the times at which estimates come."""

    def __init__(self) -> None:
        super().__init__("bench")
        self.images = self.create_publisher(Image, "/camera/image_raw", qos.IMAGE)
        self.poses = self.create_publisher(PoseStamped, "/cnc/spindle_pose", qos.POSE)
        self.clamp = self.create_client(Trigger, "/estimator/new_clamping")
        self.published_s: dict[int, float] = {}
        self.first_ms: dict[int, float] = {}
        self.last_ms: dict[int, float] = {}
        self.findings: set[str] = set()
        self.create_subscription(PartEstimate, "/omm/estimate", self._on_estimate, qos.LATCHED)

    def _on_estimate(self, estimate: PartEstimate) -> None:
        now_s = time.monotonic()
        self.findings.update(estimate.findings)
        for image in estimate.images:
            stamp = stamp_ns(image.stamp)
            if stamp in self.published_s:
                late_ms = 1e3 * (now_s - self.published_s[stamp])
                self.first_ms.setdefault(stamp, late_ms)
                if estimate.images_pending == 0:
                    self.last_ms.setdefault(stamp, late_ms)

    def play(self, messages: list[object]) -> None:
        """Publish a run at its own pace, with stamps of now."""
        shift_ns = time.time_ns() - messages[0].stamp_ns
        for message in messages:
            stamp = message.stamp_ns + shift_ns
            while time.time_ns() < stamp:
                rclpy.spin_once(self, timeout_sec=max(0.0, (stamp - time.time_ns()) / 1e9))
            if isinstance(message, ImageMessage):
                self.published_s[stamp] = time.monotonic()
                self.images.publish(image_message(message.image, stamp, "camera_optical"))
            else:
                header = Header(stamp=time_from_ns(stamp), frame_id="machine")
                pose = pose_from_transform(message.machine_T_spindle)
                self.poses.publish(PoseStamped(header=header, pose=pose))
        end_s = time.monotonic() + 1.0
        while time.monotonic() < end_s:
            rclpy.spin_once(self, timeout_sec=0.1)

    def heard(self) -> bool:
        """Whether estimator and recorder are there."""
        return self.images.get_subscription_count() > 1 and self.clamp.service_is_ready()

    def new_clamping(self) -> None:
        """Forget the images before."""
        future = self.clamp.call_async(Trigger.Request())
        rclpy.spin_until_future_complete(self, future, timeout_sec=5.0)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--clampings", type=int, default=5)
    parser.add_argument("--bumped", action="store_true")
    arguments = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", "88")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    scenario = load_scenario("bench")
    bumped_id = load_part(scenario.part_file).targets[0].id if arguments.bumped else None
    cell = draw(scenario, 5, bumped_id=bumped_id)
    messages = list(run(cell))
    with tempfile.TemporaryDirectory() as folder:
        part, calibration = write_estimator_files(cell, Path(folder))
        nodes = {
            "omm_estimator": {"part_file": part, "calibration_file": calibration},
            "omm_recorder": {"folder": Path(folder) / "run"},
        }
        processes = [start(package, parameters) for package, parameters in nodes.items()]
        try:
            rclpy.init()
            machine = Machine()
            until_s = time.monotonic() + 30.0
            while (
                machine.images.get_subscription_count() < 2 or not machine.clamp.service_is_ready()
            ):
                rclpy.spin_once(machine, timeout_sec=0.1)
                if time.monotonic() > until_s:
                    raise SystemExit("estimator and recorder do not come")
            time.sleep(1.0)
            for _ in range(arguments.clampings):
                machine.new_clamping()
                machine.play(messages)
            rclpy.shutdown()
        finally:
            for process in processes:
                process.send_signal(signal.SIGINT)
            for process in processes:
                process.wait(20)
    print(f"{len(machine.published_s)} images, {len(machine.first_ms)} in an estimate")
    for name, times in (("first estimate", machine.first_ms), ("settled", machine.last_ms)):
        p50, p99, most = np.percentile(list(times.values()), [50, 99, 100])
        print(f"{name:16} after p50 {p50:6.1f}  p99 {p99:6.1f}  at most {most:6.1f} ms")
    for finding in sorted(machine.findings):
        print(f"found: {finding}")
    return 0


def start(package: str, parameters: dict[str, object]) -> "subprocess.Popen[bytes]":
    """Run a node as a process."""
    name = package.removeprefix("omm_")
    program = Path(get_package_prefix(package)) / "lib" / package / f"{name}_node"
    given = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
    return subprocess.Popen([str(program), "--ros-args", *given])


if __name__ == "__main__":
    sys.exit(main())
