"""Hears where the simulated spindle and part truly are, on a thread of its own."""

import threading
from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from omm_core.geometry import RigidTransform
from omm_ros import qos, topics
from omm_ros.conversions import stamp_ns, transform_from_pose

_END_S = 1.0


class TruePoseListener:
    """Hands every pose on as it comes; of the part, where somebody moves it.

    In the pool of threads that serves the camera's services, each pose costs ten times as much: on
    a busy machine they came seconds late, and no image could be taken.
    """

    def __init__(
        self,
        camera: Node,
        add: Callable[[int, RigidTransform], None],
        move_part: Callable[[RigidTransform], None],
    ) -> None:
        self._add, self._move_part = add, move_part
        self.failure = ""
        """Why it no longer listens; empty while it does."""
        self._context = context = camera.context
        # A node of its own, as an executor serves whole nodes. The remapping of the camera's name
        # is not meant for it; where the topic is, the camera knows.
        self._node = Node(
            f"{camera.get_name()}_true_poses",
            namespace=camera.get_namespace(),
            context=context,
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        topic = camera.resolve_topic_name(topics.TRUE_SPINDLE_POSE)
        self._node.create_subscription(PoseStamped, topic, self._on_pose, qos.POSE)
        part = camera.resolve_topic_name(topics.TRUE_PART_POSE)
        self._node.create_subscription(PoseStamped, part, self._on_part, qos.LATCHED)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="true poses", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._executor.shutdown(timeout_sec=_END_S)
        self._thread.join(_END_S)
        self._node.destroy_node()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass  # Ctrl-C
        except Exception as error:
            if not (isinstance(error, RCLError | InvalidHandle) and not self._context.ok()):
                self.failure = f"The simulated machine is no longer heard: {error}"

    def _on_pose(self, message: PoseStamped) -> None:
        self._add(stamp_ns(message.header.stamp), transform_from_pose(message.pose))

    def _on_part(self, message: PoseStamped) -> None:
        self._move_part(transform_from_pose(message.pose))
