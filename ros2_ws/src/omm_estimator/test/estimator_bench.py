"""The other side of the estimator: a bench that publishes runs to real processes."""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
import rclpy
from ament_index_python.packages import get_package_prefix
from domain_coordinator import domain_id
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from omm_interfaces.msg import PartEstimate
from rclpy.client import Client
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from omm_ros import qos, transport
from omm_ros.conversions import image_message, pose_from_transform, time_from_ns
from omm_simulation.offline import ImageMessage

WAIT_S = 60.0


class Bench:
    """The other side of the estimator: publishes a run, hears what comes out."""

    def __init__(self, context: rclpy.Context) -> None:
        self.node = Node("bench", context=context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.estimates: list[PartEstimate] = []
        self.poses: list[PoseWithCovarianceStamped] = []
        self._processes: list[subprocess.Popen[str]] = []
        self._clients: dict[str, Client] = {}
        self.image = self.node.create_publisher(Image, "/camera/image_raw", qos.IMAGE)
        self.pose = self.node.create_publisher(PoseStamped, "/cnc/spindle_pose", qos.POSE)
        self.node.create_subscription(
            PartEstimate, "/omm/estimate", self.estimates.append, qos.LATCHED
        )
        self.node.create_subscription(
            PoseWithCovarianceStamped, "/omm/part_pose", self.poses.append, qos.LATCHED
        )

    def start(self, package: str, **parameters: object) -> "subprocess.Popen[str]":
        """A node of ours as a process, in this bench's domain."""
        program = Path(get_package_prefix(package)) / "lib" / package
        name = f"{package.removeprefix('omm_')}_node"
        given = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
        process = subprocess.Popen(
            [str(program / name), "--ros-args", *given],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=os.environ.copy(),
        )
        self._processes.append(process)
        return process

    def close(self) -> None:
        """End everything; what a failed test has left running would disturb the next one."""
        for process in self._processes:
            if process.poll() is None:
                kill(process)
        self.node.destroy_node()

    def until(
        self, condition: Callable[[], bool], what: str, came: Callable[[], object] = str
    ) -> None:
        deadline = time.monotonic() + WAIT_S
        while not condition():
            assert time.monotonic() < deadline, f"waited {WAIT_S} s for {what}; came: {came()}"
            self.executor.spin_once(timeout_sec=0.05)

    def until_heard(self, listeners: int = 1) -> None:
        """Wait until that many nodes hear images and poses."""
        self.until(
            lambda: (
                self.image.get_subscription_count() >= listeners
                and self.pose.get_subscription_count() >= listeners
            ),
            f"{listeners} subscriptions",
        )
        self.idle(0.5)  # connected on our side; they have yet to hear of our publishers

    def idle(self, seconds: float) -> None:
        """Let time pass."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.executor.spin_once(timeout_sec=0.05)

    def publish(self, message: object) -> None:
        if isinstance(message, ImageMessage):
            self.image.publish(image_message(message.image, message.stamp_ns, "camera_optical"))
            return
        header = Header(stamp=time_from_ns(message.stamp_ns), frame_id="machine")  # type: ignore[attr-defined]
        pose = pose_from_transform(message.machine_T_spindle)  # type: ignore[attr-defined]
        self.pose.publish(PoseStamped(header=header, pose=pose))

    def play(self, messages: list[object], images: int) -> PartEstimate:
        """Publish a run and wait until that many images are settled."""
        known = self._images_known()
        for message in messages:
            self.publish(message)
            self.executor.spin_once(timeout_sec=0.0)
            if isinstance(message, ImageMessage):  # as fast as it follows, however loaded
                known += 1
                self.until(partial(self._knows, known), f"image {known}'s account")
        self.until(
            lambda: (
                bool(self.estimates)
                and len(self.estimates[-1].images) == images
                and self.estimates[-1].images_pending == 0
            ),
            f"{images} settled images",
            lambda: [(len(e.images), e.images_pending) for e in self.estimates],
        )
        return self.estimates[-1]

    def _images_known(self) -> int:
        return len(self.estimates[-1].images) if self.estimates else 0

    def _knows(self, images: int) -> bool:
        return self._images_known() >= images

    def call(self, kind: type, name: str, request: object) -> object:
        if name not in self._clients:
            client = self._clients[name] = self.node.create_client(kind, name)
            self.until(client.service_is_ready, name)
            # The service may not know this reader yet, and drops an answer that nobody takes.
            self.idle(0.3)
        self.until(self._clients[name].service_is_ready, name)
        future = self._clients[name].call_async(request)
        self.until(future.done, f"the answer of {name}")
        return future.result()


@contextlib.contextmanager
def bench_in_own_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    """A bench that nobody else hears; at the end, none of the processes it started is left."""
    transport.prepare()
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with domain_id() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        context = rclpy.Context()
        context.init(domain_id=domain)
        bench = Bench(context)
        try:
            yield bench
        finally:
            bench.close()
            context.try_shutdown()


def end(process: "subprocess.Popen[str]") -> None:
    """Ctrl-C; the node must end cleanly."""
    process.send_signal(signal.SIGINT)
    told, _ = process.communicate(timeout=30)
    assert process.returncode == 0, told
    assert "Traceback" not in told, told


def kill(process: "subprocess.Popen[str]") -> None:
    """End a node without giving it a chance to clean up."""
    process.kill()
    process.communicate()
