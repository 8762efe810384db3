"""The node ``stored_result``: publishes a stored result, latched, as the estimator did.

For programs that need the part's pose after the measuring nodes have ended. Whoever starts it
vouches that the part still lies as it was measured.
"""

from __future__ import annotations

from dataclasses import dataclass

from geometry_msgs.msg import PoseWithCovarianceStamped
from omm_interfaces.msg import PartEstimate
from rclpy.node import Node
from tf2_msgs.msg import TFMessage

from omm_core.errors import InputError
from omm_estimator import conversions
from omm_estimator.stored import load_result
from omm_ros import qos, topics
from omm_ros.frames import prefixed
from omm_ros.node_main import run_node
from omm_ros.parameters import declare, network_parameter, parameter

_FRAMES_PERIOD_S = 0.5
_LOOK_PERIOD_S = 1.0


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """What is published."""

    result_file: str = parameter("", "Result, as `./omm solve RUN --json FILE` writes it.")
    part_frame: str = parameter("part", "Name of the part's frame in /tf.")
    frame_prefix: str = parameter("", "Prefix of every frame's name, for several machines: mill1/.")
    publish_tf: bool = parameter(True, "Whether machine -> part, spindle -> taper go out on /tf.")
    network: bool = network_parameter()


class StoredResultNode(Node):
    """Publishes a stored result as /omm/estimate, /omm/part_pose and /tf, latched.

    Raises
    ------
    InputError
        The file cannot be used; or, later, an estimator publishes another pose.
    """

    def __init__(self) -> None:
        super().__init__("stored_result")
        self._p = p = declare(self, Parameters)
        if not p.result_file:
            raise InputError("Expected the parameter result_file, got none.")
        self._result = result = load_result(p.result_file)
        self._estimate = self.create_publisher(PartEstimate, topics.ESTIMATE, qos.LATCHED)
        self._pose = self.create_publisher(PoseWithCovarianceStamped, topics.PART_POSE, qos.LATCHED)
        self._frames = self.create_publisher(TFMessage, topics.TF, qos.STATE)
        self._estimate.publish(prefixed(conversions.stored_estimate(result), p.frame_prefix))
        self._pose.publish(prefixed(conversions.stored_pose(result), p.frame_prefix))
        if p.publish_tf:
            self.create_timer(_FRAMES_PERIOD_S, self._publish_frames)
        self.create_timer(_LOOK_PERIOD_S, self._look)
        self.get_logger().info(f"Publishing the pose of {result.part} of {p.result_file}")

    def _publish_frames(self) -> None:
        now_ns = self.get_clock().now().nanoseconds
        frames = conversions.frames_of(self._result.own.theta, self._p.part_frame, now_ns)
        prefix = self._p.frame_prefix
        self._frames.publish(TFMessage(transforms=[prefixed(f, prefix) for f in frames]))

    def _look(self) -> None:
        """End where somebody else tells the pose of the part: two cannot both be true."""
        name = self.resolve_topic_name(topics.PART_POSE)
        others = self.count_publishers(name) - 1
        if others > 0:
            raise InputError(
                f"{name}: {others} more publish it, an estimator probably. Two poses cannot both be"
                " true: the stored one is published no longer."
            )


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(StoredResultNode, args, parameters=Parameters, threads=1)
