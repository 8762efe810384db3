"""A simulated cell with its page, and a browser in front of it; nodes can be killed and started."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from ament_index_python.packages import get_package_share_directory
from omm_interfaces.msg import OperatorCommand
from rclpy.node import Node
from sensor_msgs.msg import Image

from omm_bringup.cell import operators_page, simulated_cell
from omm_bringup.isolation import own_domain
from omm_bringup.processes import NodeSpec, executable_of
from omm_bringup.simulated_jacks import SimulatedJacks
from omm_core.geometry import RigidTransform
from omm_ros import qos, topics
from omm_ros.conversions import image_message, pose_from_transform
from omm_simulation.cell import add_wishes, draw, write_estimator_files
from omm_simulation.scenario import load_scenario

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WAIT_S = 90.0
MACHINES = Path(get_package_share_directory("omm_cnc_bridge")) / "machines"


class CellWithPage:
    """The nodes of a cell as processes, the hands at its jacks, and what the page commanded."""

    def __init__(
        self, folder: Path, port: int, *, tilt_rad: float, seed: int = 3, speed_factor: float = 1.0
    ) -> None:
        self.folder, self.port = folder, port
        cell = draw(load_scenario("bench"), seed)
        part_file, calibration_file = write_estimator_files(cell, folder)
        add_wishes(part_file, cell)
        specs = simulated_cell(folder, scenario="bench", seed=seed)
        bridge = next(spec for spec in specs if spec.name == "cnc_bridge")
        bridge.parameters["speed_factor"] = speed_factor
        page = operators_page(folder, port=port, stops=len(cell.stops))
        scene = NodeSpec(
            package="omm_operator", executable="scene_node", name="scene",
            parameters={
                "part_file": str(part_file), "calibration_file": str(calibration_file),
                "machine_file": str(MACHINES / "three_axis_mill.urdf"),
            },
        )  # fmt: skip
        self._specs = {spec.name: spec for spec in (*specs, page, scene)}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.commands: list[OperatorCommand] = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = Node("hands", context=self._context)
        tilted = RigidTransform.from_euler_xyz_rad(
            tilt_rad, -tilt_rad, 0.02, cell.machine_T_part.translation_mm
        )
        self.jacks = SimulatedJacks(self._node, tilted)
        self.jacks._moved.publish(_posed(tilted))
        self._node.create_subscription(
            OperatorCommand, topics.OPERATOR_COMMANDS, self.commands.append, qos.STATE
        )
        self._images = self._node.create_publisher(Image, topics.IMAGE, qos.IMAGE)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        for name in self._specs:
            self.start(name)

    def _spin(self) -> None:
        with contextlib.suppress(rclpy.executors.ExternalShutdownException):
            self._executor.spin()

    def start(self, name: str) -> None:
        """Start a node, or start it again."""
        spec: NodeSpec = self._specs[name]
        words = [f"{key}:={_text(value)}" for key, value in spec.parameters.items() if value != ""]
        with open(self.folder / f"{name}.log", "ab") as log:
            self.processes[name] = subprocess.Popen(
                [str(executable_of(spec)), "--ros-args", "-r", f"__node:={name}",
                 *(word for pair in words for word in ("-p", pair))],
                stdout=log, stderr=subprocess.STDOUT, env=os.environ.copy(),
            )  # fmt: skip

    def send(self, name: str, number: int) -> None:
        """Send a signal to a node; SIGKILL is waited for."""
        self.processes[name].send_signal(number)
        if number == signal.SIGKILL:
            self.processes[name].wait()

    def show_small_image(self) -> None:
        """Publish an image that is not of the calibration's sensor, as a wrong camera would."""
        stamp_ns = time.time_ns()
        self._images.publish(
            image_message(np.zeros((48, 64), dtype=np.uint8), stamp_ns, "camera_optical")
        )

    def count_publishers(self, topic: str) -> int:
        """Return how many nodes publish a topic."""
        return int(self._node.count_publishers(topic))

    def given(self, name: str, outcome: int) -> list[OperatorCommand]:
        """Commands of a name that came to an outcome."""
        return [c for c in list(self.commands) if (c.command, c.outcome) == (name, outcome)]

    def close(self) -> None:
        """End all nodes as Ctrl-C would, the recorder last."""
        for name in reversed(self._specs):
            process = self.processes[name]
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.send_signal(signal.SIGINT)
        for process in self.processes.values():
            try:
                process.wait(15.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)
        self._thread.join(5.0)


def _posed(pose: RigidTransform) -> Any:
    from geometry_msgs.msg import PoseStamped

    return PoseStamped(pose=pose_from_transform(pose))


def _text(value: object) -> str:
    return json.dumps(value) if isinstance(value, bool | int | float) else str(value)


@contextlib.contextmanager
def cell_with_page(folder: Path, port: int, **more: Any) -> Iterator[CellWithPage]:
    """A cell in a domain of its own."""
    with own_domain():
        running = CellWithPage(folder, port, **more)
        try:
            yield running
        finally:
            running.close()


def until(condition: Any, what: str, seconds: float = WAIT_S) -> float:
    """Wait for a condition; returns how long it took."""
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < seconds, f"waited {seconds} s for {what}"
        time.sleep(0.02)
    return time.monotonic() - start
