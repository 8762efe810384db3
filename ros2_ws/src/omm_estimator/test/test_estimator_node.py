"""The estimator as a process over DDS: it estimates, accounts for every image, and starts anew."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from ament_index_python.packages import get_package_prefix
from domain_coordinator import domain_id
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from omm_interfaces.msg import PartEstimate
from omm_interfaces.srv import LoadPart
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from omm_ros import qos, transport
from omm_ros.conversions import image_message, pose_from_transform, time_from_ns
from omm_simulation.cell import Cell, draw, write_estimator_files
from omm_simulation.offline import Faults, ImageMessage, run
from omm_simulation.scenario import load_scenario

WAIT_S = 60.0


class Bench:
    """The other side of the estimator: publishes a run, hears what comes out."""

    def __init__(self, context: rclpy.Context) -> None:
        self.node = Node("bench", context=context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.estimates: list[PartEstimate] = []
        self.poses: list[PoseWithCovarianceStamped] = []
        self.image = self.node.create_publisher(Image, "/camera/image_raw", qos.IMAGE)
        self.pose = self.node.create_publisher(PoseStamped, "/cnc/spindle_pose", qos.POSE)
        self.node.create_subscription(
            PartEstimate, "/omm/estimate", self.estimates.append, qos.LATCHED
        )
        self.node.create_subscription(
            PoseWithCovarianceStamped, "/omm/part_pose", self.poses.append, qos.LATCHED
        )

    def until(
        self, condition: Callable[[], bool], what: str, came: Callable[[], object] = str
    ) -> None:
        deadline = time.monotonic() + WAIT_S
        while not condition():
            assert time.monotonic() < deadline, f"waited {WAIT_S} s for {what}; came: {came()}"
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
        for message in messages:
            self.publish(message)
            self.executor.spin_once(timeout_sec=0.0)
            if isinstance(message, ImageMessage):
                time.sleep(0.2)  # as fast as the estimator can follow on a loaded machine
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

    def call(self, kind: type, name: str, request: object) -> object:
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, name)
        future = client.call_async(request)
        self.until(future.done, f"the answer of {name}")
        return future.result()


@pytest.fixture(scope="module")
def cell() -> Cell:
    return draw(load_scenario("bench"), 5)


@pytest.fixture(scope="module")
def messages(cell: Cell) -> list[object]:
    return list(run(cell))


@pytest.fixture
def bench(tmp_path: Path, cell: Cell, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    """An estimator process in a domain of its own, and the bench beside it."""
    transport.prepare()
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    part, calibration = write_estimator_files(cell, tmp_path)
    with domain_id() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        process = start(part, calibration)
        context = rclpy.Context()
        context.init(domain_id=domain)
        bench = Bench(context)
        try:
            bench.until(lambda: bool(bench.estimates), "the estimator")
            bench.until(
                lambda: (
                    bench.image.get_subscription_count() > 0
                    and bench.pose.get_subscription_count() > 0
                ),
                "its subscriptions",
            )
            time.sleep(0.5)  # connected on our side; it has yet to hear of our publishers
            yield bench
        finally:
            process.send_signal(signal.SIGINT)
            told, _ = process.communicate(timeout=20)
            bench.node.destroy_node()
            context.try_shutdown()
    assert process.returncode == 0, told
    assert "Traceback" not in told, told


def start(part: Path, calibration: Path) -> "subprocess.Popen[str]":
    folder = Path(get_package_prefix("omm_estimator")) / "lib" / "omm_estimator"
    arguments = ["--ros-args", "-p", f"part_file:={part}", "-p", f"calibration_file:={calibration}"]
    return subprocess.Popen(
        [str(folder / "estimator_node"), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ.copy(),
    )


def test_a_run_gives_the_truth_within_its_covariance(
    bench: Bench, cell: Cell, messages: list[object]
) -> None:
    estimate = bench.play(messages, images=8)
    assert estimate.determined
    assert estimate.converged
    truth = np.array(list(cell.theta().values())) / [1, 1, 1, 1000, 1000, 1000, 1]
    sigma = np.sqrt(np.diag(np.array(estimate.covariance).reshape(7, 7)))
    assert np.all(np.abs(np.array(estimate.theta) - truth) < 4.5 * sigma)
    assert {t.id: t.images for t in estimate.targets} == {42: 2, 40: 2, 8: 2, 122: 2}
    bench.until(lambda: bool(bench.poses), "the part's pose")
    assert bench.poses[-1].pose.pose.position.x == pytest.approx(truth[3])


def test_nothing_is_estimated_before_it_is_determined(bench: Bench, messages: list[object]) -> None:
    second_image = [i for i, m in enumerate(messages) if isinstance(m, ImageMessage)][1]
    estimate = bench.play(messages[: second_image + 40], images=2)
    assert not estimate.determined
    assert np.all(np.isnan(estimate.theta))
    assert estimate.missing


def test_images_that_cannot_be_used_are_accounted_for_and_the_rest_is_solved(
    bench: Bench, cell: Cell
) -> None:
    faults = Faults(without_poses=frozenset({3}), moving=frozenset({6}))
    estimate = bench.play(list(run(cell, faults=faults)), images=8)
    refused = [image.reason for image in estimate.images if not image.used]
    assert len(refused) == 2
    assert any("gap" in reason or "no spindle pose" in reason for reason in refused)
    assert any("moved" in reason for reason in refused)
    assert estimate.determined


def test_an_image_of_another_size_is_refused_with_the_sizes(bench: Bench) -> None:
    bench.image.publish(image_message(np.zeros((480, 640), np.uint8), 10**18, "camera_optical"))
    bench.until(lambda: len(bench.estimates[-1].images) == 1, "the image's account")
    status = bench.estimates[-1].images[0]
    assert not status.used
    assert "2592" in status.reason
    assert "640" in status.reason


def test_a_new_clamping_and_another_part_forget_the_images(
    bench: Bench, messages: list[object], tmp_path: Path
) -> None:
    second_image = [i for i, m in enumerate(messages) if isinstance(m, ImageMessage)][1]
    bench.play(messages[: second_image + 40], images=2)
    answer = bench.call(Trigger, "/estimator/new_clamping", Trigger.Request())
    assert answer.success  # type: ignore[attr-defined]
    bench.until(lambda: not bench.estimates[-1].images, "an empty estimate")
    wrong = bench.call(LoadPart, "/estimator/load_part", LoadPart.Request(part_file="nowhere"))
    assert not wrong.success  # type: ignore[attr-defined]
    assert "nowhere" in wrong.message  # type: ignore[attr-defined]
    other = tmp_path / "other.yaml"
    other.write_text((tmp_path / "part.yaml").read_text().replace("name: bench", "name: gantry"))
    right = bench.call(LoadPart, "/estimator/load_part", LoadPart.Request(part_file=str(other)))
    assert right.success  # type: ignore[attr-defined]
    bench.until(lambda: bench.estimates[-1].part == "gantry", "the other part")


@pytest.mark.parametrize("missing", ["part_file", "calibration_file"])
def test_without_its_files_it_says_so_and_ends_with_status_2(
    tmp_path: Path, cell: Cell, missing: str
) -> None:
    part, calibration = write_estimator_files(cell, tmp_path)
    files = {"part_file": part, "calibration_file": calibration, missing: tmp_path / "nowhere"}
    process = start(files["part_file"], files["calibration_file"])
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 2, told
    assert "nowhere" in told
