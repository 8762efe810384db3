"""A subscription that takes what its publishers offer, and tells when that is less than it wants.

A reliable subscription hears nothing of a best-effort publisher: many camera drivers publish so. It
would look as if no camera were there.
"""

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy


class AdaptiveSubscription:
    """Subscribes reliably; where a publisher offers only best effort, anew with that.

    Parameters
    ----------
    node : who listens
    kind, topic, callback, profile : as `Node.create_subscription` takes them
    """

    def __init__(
        self, node: Node, kind: type, topic: str, callback: Callable[..., None], profile: QoSProfile
    ) -> None:
        self._node, self._kind, self._topic, self._callback = node, kind, topic, callback
        self._profile = profile
        self._again: Any = None
        self.trouble = ""
        """What an operator must know; empty where all is as wanted."""
        self._subscription = self._subscribe()

    def destroy(self) -> None:
        """Stop listening."""
        if self._again is not None:
            self._node.destroy_timer(self._again)
            self._again = None
        self._node.destroy_subscription(self._subscription)

    def _subscribe(self) -> Any:
        return self._node.create_subscription(
            self._kind,
            self._topic,
            self._callback,
            self._profile,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible),
        )

    def _on_incompatible(self, event: Any) -> None:
        if self._profile.reliability is ReliabilityPolicy.BEST_EFFORT:
            self.trouble = f"a publisher of {self._topic} offers a service that does not fit"
            return
        self._profile = QoSProfile(
            history=self._profile.history,
            depth=self._profile.depth,
            durability=self._profile.durability,
            reliability=ReliabilityPolicy.BEST_EFFORT,
        )
        self.trouble = f"{self._topic} is published with best effort only: messages may be lost"
        self._node.get_logger().warning(self.trouble)
        # Not from within the subscription's own event.
        self._again = self._node.create_timer(0.0, self._subscribe_again)

    def _subscribe_again(self) -> None:
        self._node.destroy_timer(self._again)
        self._again = None
        old, self._subscription = self._subscription, self._subscribe()
        self._node.destroy_subscription(old)
