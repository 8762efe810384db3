"""What a worker tells: to whom, and as a snapshot for diagnostics."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

from omm_camera_driver.driver import (
    Camera,
    Frame,
)


class WorkerState(str, Enum):
    """What the connection is in."""

    INACTIVE = "inactive"
    ABSENT = "absent"
    OPENING = "opening"
    STREAMING = "streaming"
    LOST = "lost"


class Listener(Protocol):
    """Who gets the frames and hears of what happens; called on the worker's thread."""

    def on_frame(self, frame: Frame) -> None:
        """Take an image."""

    def on_connected(self, camera: Camera) -> None:
        """Note that a camera was connected."""

    def on_problem(self, problem: str) -> None:
        """Note what keeps the camera from working."""


@dataclass(frozen=True, kw_only=True)
class Status:
    """A snapshot for diagnostics."""

    state: WorkerState = WorkerState.ABSENT
    problem: str = ""
    camera: Camera | None = None
    published: int = 0
    incomplete: int = 0
    missing: int = 0
    stale: int = 0
    unanswered_triggers: int = 0
    connections: int = 0
    clock_steps: int = 0
    rate_hz: float = 0.0
    stamp_uncertainty_ns: int = 0
    health: Mapping[str, Any] = field(default_factory=dict)


def why_not(status: Status) -> str:
    """Return why no image can be had at the moment, for who asked for one."""
    if status.state is WorkerState.INACTIVE:
        return "The camera node is not active. Activate it first."
    if status.problem:
        return f"The camera is {status.state.value}: {status.problem}"
    return f"The camera is {status.state.value}. Try again when it is streaming."
