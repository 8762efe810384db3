"""How many messages a node has published: a recorder compares it with what it received.

DDS numbers the messages of each publisher, so that a listener sees what is missing between two of
them; of what is missing after the last one only the publisher knows. rclpy does not tell the
number, so omm's nodes have publishers that count, and tell the counts with their diagnostics.
"""

from collections.abc import Mapping
from typing import Any

from rclpy.lifecycle import LifecycleNode
from rclpy.lifecycle.managed_entity import SimpleManagedEntity
from rclpy.node import Node
from rclpy.publisher import Publisher

NAME = "published"
_NOT_COUNTED = ("/diagnostics", "/rosout")
"""Several nodes publish these; the first changes while it is being told."""


class CountedPublisher(Publisher):
    """A publisher that knows how many messages it has published.

    Attributes
    ----------
    count : int
        So many; each publisher belongs to one thread at a time.
    """

    count = 0

    def publish(self, msg: Any) -> None:
        """Publish a message, and count it once that has worked."""
        super().publish(msg)
        self.count += 1


class CountedLifecyclePublisher(SimpleManagedEntity, CountedPublisher):
    """The same for lifecycle nodes: silent unless the node is active."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        SimpleManagedEntity.__init__(self)
        CountedPublisher.__init__(self, *arguments, **options)

    @SimpleManagedEntity.when_enabled
    def publish(self, msg: Any) -> None:
        """Publish a message, and count it, if the node is active."""
        CountedPublisher.publish(self, msg)


class CountingNode(Node):
    """A node whose publishers count, those that rclpy makes for it as well."""

    def create_publisher(
        self, *arguments: Any, publisher_class: type[Publisher] = CountedPublisher, **options: Any
    ) -> Publisher:
        """Create a publisher that counts."""
        return super().create_publisher(*arguments, publisher_class=publisher_class, **options)


class CountingLifecycleNode(LifecycleNode):
    """A lifecycle node whose publishers count."""

    def create_publisher(
        self, *arguments: Any, publisher_class: type[Publisher] = CountedPublisher, **options: Any
    ) -> Publisher:
        """Create a publisher that counts."""
        return super().create_publisher(*arguments, publisher_class=publisher_class, **options)

    def create_lifecycle_publisher(self, *arguments: Any, **options: Any) -> Publisher:
        """Create a publisher that counts, and is silent unless the node is active."""
        made = self.create_publisher(
            *arguments, publisher_class=CountedLifecyclePublisher, **options
        )
        self.add_managed_entity(made)
        return made


def published(node: Node) -> dict[str, int]:
    """Return how many messages the counting publishers of a node have published, by topic."""
    return {
        publisher.topic_name: publisher.count
        for publisher in list(node.publishers)
        if isinstance(publisher, CountedPublisher) and publisher.topic_name not in _NOT_COUNTED
    }


def parsed(values: Mapping[str, str]) -> dict[str, int]:
    """Return the counts that a node told; what is not a number is left out."""
    return {
        topic: int(text)
        for topic, text in values.items()
        if text.isascii() and text.isdigit() and len(text) < 19
    }
