"""A subscription hears publishers of either reliability, and tells which it heard."""

import os
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from omm_ros import qos
from omm_ros.adaptive_subscription import AdaptiveSubscription

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
WAIT_S = 20.0


@pytest.fixture
def node() -> Iterator[Node]:
    context = rclpy.Context()
    context.init()
    node = Node("listener", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT])
def test_a_message_arrives_and_best_effort_is_told(
    node: Node, reliability: ReliabilityPolicy
) -> None:
    heard: list[str] = []
    listening = AdaptiveSubscription(
        node, String, "~/words", lambda message: heard.append(message.data), qos.IMAGE
    )
    publisher = node.create_publisher(
        String, "~/words", QoSProfile(depth=5, reliability=reliability)
    )
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    deadline_s = time.monotonic() + WAIT_S
    while not heard and time.monotonic() < deadline_s:
        publisher.publish(String(data="here"))
        executor.spin_once(timeout_sec=0.05)
    assert heard
    lossy = reliability is ReliabilityPolicy.BEST_EFFORT
    assert ("best effort" in listening.trouble) == lossy
    listening.destroy()
    executor.shutdown()
