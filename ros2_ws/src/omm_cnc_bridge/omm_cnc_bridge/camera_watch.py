"""Whether the camera can be asked for images: its service is there long before its images are."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.client import Client
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo

from omm_ros import qos, topics
from omm_ros.diagnostics import line_name

SILENT_S = 5.0
"""A camera node of others may say nothing of itself: after so long it is asked all the same."""
_STREAMING = "streaming"


class CameraWatch:
    """Hears what the camera says of its connection, and that an image was published.

    Parameters
    ----------
    node : who listens
    trigger : client of the camera's service ``<camera>/trigger``; the camera is named after it
    """

    def __init__(self, node: Node, trigger: Client) -> None:
        self._trigger = trigger
        camera = node.resolve_service_name(trigger.srv_name).rpartition("/")[0]
        self._line = line_name(camera, "connection")
        self._said = ""
        self._streams = False
        self._ready_s: float | None = None
        node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, 10)
        node.create_subscription(CameraInfo, topics.CAMERA_INFO, self._on_info, qos.IMAGE)

    def awaited(self) -> str:
        """Return what is waited for, in words; empty when images can be asked for."""
        if not self._trigger.service_is_ready():
            self._ready_s = None
            return f"the service {self._trigger.srv_name}"
        if self._streams:
            return ""
        if self._ready_s is None:
            self._ready_s = time.monotonic()
        if self._said:
            return f"the camera to stream; it says: {self._said}"
        if time.monotonic() - self._ready_s > SILENT_S:
            return ""
        return "the camera to say that it streams, or an image"

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._line:
                self._streams = _state(status) == _STREAMING
                self._said = "" if self._streams else status.message

    def _on_info(self, message: CameraInfo) -> None:
        """Take an image's camera_info: what is published has been taken."""
        self._streams = True


def _state(status: DiagnosticStatus) -> str:
    told = {value.key: value.value for value in status.values}
    of_level = _STREAMING if status.level == DiagnosticStatus.OK else ""
    return str(told.get("state", of_level))
