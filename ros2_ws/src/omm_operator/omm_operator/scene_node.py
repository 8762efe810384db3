"""The node ``scene``: markers, robot_description and joint_states for RViz and Foxglove."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from omm_interfaces.msg import PartEstimate, SpindleState
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from omm_core.errors import InputError
from omm_core.files.machine import load_machine
from omm_core.files.outside import read_text
from omm_core.files.part import load_part
from omm_core.imaging.calibration import load_calibration
from omm_core.machine.urdf import Robot, load_urdf
from omm_operator.conversions import estimate_fact
from omm_operator.scene import camera_view, link_frames, part_markers
from omm_ros import qos, topics
from omm_ros.frames import prefixed
from omm_ros.node_main import run_node
from omm_ros.parameters import declare, network_parameter, parameter
from omm_ros.published import CountingNode


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """See docs/operator.md."""

    part_file: str = parameter("", "Part file: box and targets.")
    calibration_file: str = parameter("", "Calibration file: the camera's view.")
    machine_file: str = parameter(
        "", "URDF or machine.yaml, for robot_description; empty: none is published."
    )
    enlargement: float = parameter(
        1000.0, "How many times ellipsoids of uncertainty are enlarged.", minimum=1.0
    )
    view_depth_m: float = parameter(0.3, "How far the camera's view is drawn.", minimum=0.01)
    part_frame: str = parameter("part", "Frame of the part.")
    machine_frame: str = parameter("machine", "Frame of the machine.")
    tip: str = parameter(
        "spindle", "Link whose frame the bridge tells; the others are told here, from the root."
    )
    camera_frame: str = parameter("camera_optical", "Frame of the camera.")
    frame_prefix: str = parameter("", "Prefix of every frame's name, for several machines: mill1/.")
    network: bool = network_parameter()


class SceneNode(CountingNode):
    """Shows engineers what was measured.

    Raises
    ------
    InputError
        Where a file cannot be used.
    """

    def __init__(self) -> None:
        super().__init__("scene")
        self._p = p = declare(self, Parameters)
        if not p.part_file:
            raise InputError("Expected the parameter part_file, got none.")
        self._part = load_part(p.part_file)
        self._markers = self.create_publisher(MarkerArray, topics.MARKERS, qos.LATCHED)
        self._robot: Robot | None = None
        self._joints = self.create_publisher(JointState, topics.JOINT_STATES, qos.STATE)
        if p.calibration_file:
            view = camera_view(
                load_calibration(p.calibration_file),
                p.frame_prefix + p.camera_frame,
                p.view_depth_m * 1e3,
            )
            self._view = self.create_publisher(MarkerArray, topics.CAMERA_VIEW, qos.LATCHED)
            self._view.publish(view)
        if p.machine_file:
            self._description = self.create_publisher(String, topics.ROBOT_DESCRIPTION, qos.LATCHED)
            urdf = load_machine(p.machine_file).urdf
            self._description.publish(String(data=read_text(urdf, "URDF")))
            self._robot = load_urdf(Path(urdf))
            self._frames = self.create_publisher(TFMessage, topics.TF, qos.STATE)
        self.create_subscription(PartEstimate, topics.ESTIMATE, self._on_estimate, qos.LATCHED)
        self.create_subscription(SpindleState, topics.SPINDLE_STATE, self._on_state, qos.STATE)

    def _on_estimate(self, message: PartEstimate) -> None:
        self._markers.publish(
            part_markers(
                estimate_fact(message),
                self._part,
                part_frame=self._p.frame_prefix + self._p.part_frame,
                machine_frame=self._p.frame_prefix + self._p.machine_frame,
                enlargement=self._p.enlargement,
            )
        )

    def _on_state(self, message: SpindleState) -> None:
        joints = JointState(name=list(message.axis_names), position=list(message.axis_positions))
        joints.header = message.header
        self._joints.publish(joints)
        if self._robot is not None:
            positions = dict(zip(message.axis_names, message.axis_positions))
            frames = link_frames(self._robot, positions, message.header.stamp, self._p.tip)
            if frames:
                prefix = self._p.frame_prefix
                self._frames.publish(TFMessage(transforms=[prefixed(f, prefix) for f in frames]))


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(SceneNode, args, parameters=Parameters, threads=1)
