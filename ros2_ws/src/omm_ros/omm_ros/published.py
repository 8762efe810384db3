"""How many messages this process has published: a recorder compares it with what it received.

DDS numbers the messages of each publisher, so that a listener sees what is missing between two of
them; of what is missing after the last one only the publisher knows. rclpy does not tell the
number, so it is counted here, and told with the node's diagnostics.
"""

from collections.abc import Mapping

from rclpy.node import Node
from rclpy.publisher import Publisher

NAME = "published"
_COUNT = "_omm_published"
_NOT_COUNTED = ("/diagnostics", "/rosout")
"""Several nodes publish these; the first changes while it is being told."""


def count_publications() -> None:
    """Count from now on what every publisher of this process publishes."""
    if hasattr(Publisher.publish, _COUNT):
        return
    plain = Publisher.publish

    def publish(self: Publisher, msg: object) -> None:
        plain(self, msg)
        # After it, so that a message that could not be published does not count. Each publisher
        # belongs to one thread at a time.
        setattr(self, _COUNT, getattr(self, _COUNT, 0) + 1)

    setattr(publish, _COUNT, True)
    Publisher.publish = publish


def published(node: Node) -> dict[str, int]:
    """Return how many messages the publishers of a node have published, by topic."""
    return {
        publisher.topic_name: getattr(publisher, _COUNT, 0)
        for publisher in list(node.publishers)
        if publisher.topic_name not in _NOT_COUNTED
    }


def parsed(values: Mapping[str, str]) -> dict[str, int]:
    """Return the counts that a node told; what is no number is left out."""
    return {
        topic: int(text)
        for topic, text in values.items()
        if text.isascii() and text.isdigit() and len(text) < 19
    }
