"""The node as a process over ROS, and a node of the test's that hears it and plays the camera."""

import signal
import subprocess
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from omm_interfaces.msg import SpindleState
from omm_interfaces.srv import Mdi, TriggerImage
from std_srvs.srv import Trigger

from omm_ros import qos
from omm_ros.conversions import stamp_ns

_MATCHED_S = 0.3

NODE = "import sys; from omm_cnc_bridge.node import main; sys.exit(main())"


class Bench:
    """A node of the test's that listens to the bridge and plays the camera."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        self.context.init(domain_id=domain)
        self.node = rclpy.create_node("bench", context=self.context)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.poses, self.truth, self.states = [], [], []
        self.heard_ns = []  # when each of the poses came
        self.triggered = 0
        self.images_ns = []
        self.diagnostics = {}
        self.camera_works = True
        self.camera_takes_s = 0.0
        self._clients = {}
        n = self.node
        n.create_subscription(PoseStamped, "/cnc/spindle_pose", self._on_pose, qos.POSE)
        n.create_subscription(
            PoseStamped, "/simulation/true_spindle_pose", self.truth.append, qos.POSE
        )
        n.create_subscription(SpindleState, "/cnc/state", self.states.append, qos.STATE)
        n.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        n.create_service(TriggerImage, "/camera/trigger", self._on_trigger)
        self.camera_says = "streaming"  # on /diagnostics, twice a second; empty: nothing
        self._saying = n.create_publisher(DiagnosticArray, "/diagnostics", 10)
        n.create_timer(0.5, self._say)

    def _on_pose(self, message) -> None:
        self.heard_ns.append(time.time_ns())
        self.poses.append(message)

    def _on_diagnostics(self, message) -> None:
        self.diagnostics |= {status.name: status for status in message.status}

    def _on_trigger(self, request, response):
        self.triggered += 1
        time.sleep(self.camera_takes_s)
        response.success, response.message = self.camera_works, "out of light"
        response.stamp = self.node.get_clock().now().to_msg()
        self.images_ns.append(stamp_ns(response.stamp))
        return response

    def _say(self) -> None:
        if not self.camera_says:
            return
        fine = self.camera_says == "streaming"
        level = DiagnosticStatus.OK if fine else DiagnosticStatus.ERROR
        status = DiagnosticStatus(name="camera: connection", level=level, message=self.camera_says)
        self._saying.publish(DiagnosticArray(status=[status]))

    def spin(self, seconds: float, until=lambda: False) -> bool:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.05)
            if until():
                return True
        return False

    def call(self, name: str):
        return self.wait_for(self.send(Trigger, name, Trigger.Request()))

    def mdi(self, block: str):
        return self.wait_for(self.send(Mdi, "/cnc_bridge/mdi", Mdi.Request(command=block)))

    def send(self, kind: type, name: str, request):
        """Future of a service's answer."""
        if name not in self._clients:
            client = self._clients[name] = self.node.create_client(kind, name)
            assert self.spin(10.0, client.service_is_ready)
            # The service may not know this reader yet, and drops an answer that nobody takes.
            self.spin(_MATCHED_S)
        assert self.spin(10.0, self._clients[name].service_is_ready)
        return self._clients[name].call_async(request)

    def wait_for(self, future):
        assert self.spin(30.0, future.done)
        return future.result()

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


def start_bridge(**parameters) -> "subprocess.Popen[str]":
    """The bridge's process; ROS_DOMAIN_ID is taken from the environment."""
    words = [w for k, v in parameters.items() for w in ("-p", f"{k}:={v}")]
    command = [sys.executable, "-c", NODE, "--ros-args", *words]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def end(process: "subprocess.Popen[str]", patience_s: float = 5.0) -> float:
    """Ctrl-C; the node must end cleanly. Returns how long it took, s."""
    asked = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, text = process.communicate(timeout=patience_s)
    assert process.returncode == 0, text
    assert "Traceback" not in text, text
    return time.monotonic() - asked
