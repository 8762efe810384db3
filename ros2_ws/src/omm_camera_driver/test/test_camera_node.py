"""The camera node as a process, with a GigE camera that is switched off and on under it."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from omm_interfaces.srv import TriggerImage
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Empty

from omm_ros import qos, transport
from omm_ros.conversions import image_from_message, stamp_ns
from omm_simulation.scenario import load_scenario

sys.path.insert(0, str(Path(__file__).parent))
from camera_peers import ADDRESS, CameraProcess
from gige_camera_process import begin_of, pattern

DOMAIN = 30 + os.getpid() % 60
CODE = "from omm_camera_driver.node import main; main()"


class Cell:
    """A listener of the camera node, and the node's process."""

    def __init__(self) -> None:
        transport.prepare()
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node("camera_test", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.images: list[Image] = []
        self.infos: list[CameraInfo] = []
        self.health: list[DiagnosticStatus] = []
        node = self.node
        node.create_subscription(Image, "/camera/image_raw", self.images.append, qos.IMAGE)
        node.create_subscription(CameraInfo, "/camera/camera_info", self.infos.append, qos.IMAGE)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.take_image = node.create_publisher(Empty, "/camera/take_image", qos.STATE)
        self.trigger = node.create_client(TriggerImage, "/camera/trigger")
        self.parameters = node.create_client(SetParameters, "/camera/set_parameters")
        scenario = load_scenario("bench")
        given = {
            "driver": "gige", "device": ADDRESS, "trigger": "software", "exposure_us": 2000.0,
            "calibration_file": scenario.calibration_file,
            "roi_width_px": 640, "roi_height_px": 480,
        }  # fmt: skip
        words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
        environment = dict(
            os.environ, PYTHONPATH=os.pathsep.join(sys.path), ROS_DOMAIN_ID=str(DOMAIN)
        )
        command = [sys.executable, "-c", CODE, "--ros-args", *words]
        self.process = subprocess.Popen(command, env=environment)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.health += [s for s in message.status if s.name == "camera: connection"]

    def wait_for(self, condition: Callable[[], Any], timeout_s: float = 60.0) -> None:
        """Go on listening until something is true."""
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline_s, self.health[-1:]
            self.executor.spin_once(timeout_sec=0.05)

    def is_connected(self) -> bool:
        return bool(self.health) and self.health[-1].level == DiagnosticStatus.OK

    def call(self, client: Any, request: Any, timeout_s: float = 10.0) -> Any:
        self.wait_for(client.service_is_ready)
        future = client.call_async(request)
        self.wait_for(future.done, timeout_s)
        return future.result()

    def end(self) -> float:
        """Press Ctrl-C; seconds until the process is gone."""
        begin_s = time.monotonic()
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(10.0) == 0
        return time.monotonic() - begin_s

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def cell(camera_process: CameraProcess) -> Iterator[Cell]:
    cell = Cell()
    yield cell
    cell.close()


def exposure(value_us: float) -> SetParameters.Request:
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value_us)
    return SetParameters.Request(parameters=[Parameter(name="exposure_us", value=value)])


def test_a_trigger_is_answered_with_the_stamp_of_the_published_image(
    cell: Cell, camera_process: CameraProcess
) -> None:
    camera_process.start()
    cell.wait_for(cell.is_connected)
    answer = cell.call(cell.trigger, TriggerImage.Request())
    assert answer.success, answer.message
    cell.wait_for(lambda: cell.images and cell.infos)
    (image,), (info,) = cell.images, cell.infos
    assert answer.stamp == image.header.stamp == info.header.stamp
    assert (image.encoding, image.header.frame_id) == ("mono8", "camera_optical")
    pixels = image_from_message(image)
    assert (pixels == pattern(begin_of(pixels))).all()
    assert info.distortion_model == "plumb_bob"
    assert len(info.d) == 5
    assert abs(stamp_ns(image.header.stamp) - begin_of(pixels) - 1_000_000) < 20_000_000
    cell.take_image.publish(Empty())
    cell.wait_for(lambda: len(cell.images) == 2)
    assert cell.end() < 2.0


def test_exposure_is_a_parameter_with_the_camera_s_range(
    cell: Cell, camera_process: CameraProcess
) -> None:
    camera_process.start()
    cell.wait_for(cell.is_connected)
    (accepted,) = cell.call(cell.parameters, exposure(4000.0)).results
    assert accepted.successful, accepted.reason
    (refused,) = cell.call(cell.parameters, exposure(2e7)).results
    assert not refused.successful
    assert "from 10 to 1e+07 µs" in refused.reason


def test_services_answer_and_ctrl_c_ends_it_while_the_camera_is_away(
    cell: Cell, camera_process: CameraProcess
) -> None:
    cell.wait_for(lambda: cell.health and cell.health[-1].level == DiagnosticStatus.ERROR)
    answer = cell.call(cell.trigger, TriggerImage.Request(), timeout_s=5.0)
    assert not answer.success
    assert "found none" in answer.message or "opening" in answer.message
    camera_process.start()
    cell.wait_for(cell.is_connected)
    camera_process.pull()
    cell.wait_for(lambda: not cell.is_connected())
    assert "does not answer" in cell.health[-1].message
    assert not cell.call(cell.trigger, TriggerImage.Request(), timeout_s=5.0).success
    assert cell.end() < 2.0  # while Aravis still waits for the camera
    camera_process.plug_in()


def test_it_can_be_deactivated_and_activated_while_the_camera_is_away(
    cell: Cell, camera_process: CameraProcess
) -> None:
    camera_process.start()
    cell.wait_for(cell.is_connected)
    camera_process.pull()
    cell.wait_for(lambda: not cell.is_connected())
    change = cell.node.create_client(ChangeState, "/camera/change_state")
    for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
        request = ChangeState.Request(transition=Transition(id=transition))
        assert cell.call(change, request, timeout_s=5.0).success
    camera_process.plug_in()
    cell.wait_for(cell.is_connected)
    cell.images.clear()
    answer = cell.call(cell.trigger, TriggerImage.Request())
    assert answer.success, answer.message
    cell.wait_for(lambda: cell.images)
    assert cell.images[0].header.stamp == answer.stamp
    assert cell.end() < 2.0
