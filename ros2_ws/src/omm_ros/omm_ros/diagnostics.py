"""What a node says of its health on /diagnostics, once a second and at every change of level."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from omm_core.words import beside, keyed
from omm_ros import topics
from omm_ros.published import NAME as PUBLISHED
from omm_ros.published import published

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR
STALE = DiagnosticStatus.STALE
FINE = keyed("said.fine", "fine")
SAID = "said"
"""Of the value that holds the message's key and arguments, see `omm_core.words.beside`."""


@dataclass(frozen=True, kw_only=True)
class Health:
    """One line of diagnostics: what an operator reads, and the figures behind it."""

    level: bytes = OK
    message: str = FINE
    values: Mapping[str, object] = field(default_factory=dict)


def line_name(node: str, line: str) -> str:
    """Return a line's name: the node's full name, so that two machines' cameras are told apart."""
    return f"{node.lstrip('/')}: {line}"


class Diagnostics:
    """Publishes what the registered functions return.

    Parameters
    ----------
    node : the node that speaks
    hardware_id : what it speaks of: a serial number, a control's address
    """

    def __init__(self, node: Node, hardware_id: str = "", period_s: float = 1.0) -> None:
        self.hardware_id = hardware_id
        self._node = node
        self._tasks: dict[str, Callable[[], Health]] = {}
        self._publisher = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, 10)
        self._timer = node.create_timer(period_s, self.publish)

    def add(self, name: str, task: Callable[[], Health]) -> None:
        """Register a function that tells the health of `name`."""
        self._tasks[name] = task

    def publish(self) -> None:
        """Publish now."""
        array = DiagnosticArray()
        array.header.stamp = self._node.get_clock().now().to_msg()
        for name, task in self._tasks.items():
            health = task()
            said = beside(health.message)
            values = {**health.values, **({SAID: said} if said else {})}
            array.status.append(
                DiagnosticStatus(
                    level=health.level,
                    name=line_name(self._node.get_fully_qualified_name(), name),
                    message=health.message,
                    hardware_id=self.hardware_id,
                    values=[KeyValue(key=k, value=str(v)) for k, v in values.items()],
                )
            )
        array.status.append(self._published())
        self._publisher.publish(array)

    def _published(self) -> DiagnosticStatus:
        counts = published(self._node)
        return DiagnosticStatus(
            level=OK,
            name=line_name(self._node.get_fully_qualified_name(), PUBLISHED),
            message="messages published, by topic",
            hardware_id=self.hardware_id,
            values=[KeyValue(key=topic, value=str(count)) for topic, count in counts.items()],
        )
