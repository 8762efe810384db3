"""The hands at the jacks of a simulated cell: they turn them as the operator's page says."""

import json

from geometry_msgs.msg import PoseStamped
from omm_interfaces.msg import OperatorCommand
from rclpy.node import Node

from omm_core.geometry import RigidTransform
from omm_ros import qos, topics
from omm_ros.conversions import pose_from_transform
from omm_simulation.jacks import lifted_by_command


class SimulatedJacks:
    """Moves the simulated part when a page says that its jacks were turned.

    Parameters
    ----------
    node : the node that listens
    machine_T_part : where the part truly is
    """

    def __init__(self, node: Node, machine_T_part: RigidTransform) -> None:
        self.machine_T_part = machine_T_part
        self._moved = node.create_publisher(PoseStamped, topics.TRUE_PART_POSE, qos.LATCHED)
        node.create_subscription(
            OperatorCommand, topics.OPERATOR_COMMANDS, self._on_command, qos.STATE
        )

    def _on_command(self, message: OperatorCommand) -> None:
        if message.command != "corrected" or message.outcome != OperatorCommand.ACCEPTED:
            return
        jacks = json.loads(message.arguments)["jacks"]
        self.machine_T_part = lifted_by_command(self.machine_T_part, jacks)
        pose = PoseStamped(pose=pose_from_transform(self.machine_T_part))
        pose.header.frame_id = "machine"
        self._moved.publish(pose)
