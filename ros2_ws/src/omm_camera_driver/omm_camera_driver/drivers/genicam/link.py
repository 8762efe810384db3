"""What differs between the links that a GenICam camera may hang on: Ethernet or USB."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from omm_camera_driver.drivers.genicam.camera_clock import ClockReading
from omm_camera_driver.drivers.genicam.settings import GenicamSettings


@dataclass(frozen=True, kw_only=True)
class Linked:
    """A camera that has been opened.

    Attributes
    ----------
    handle : int
        Aravis' `ArvCamera`; whoever opened the link lets go of it.
    notes : tuple of str
        What is usable and yet not as it should be.
    """

    handle: int
    vendor: str
    model: str
    serial: str
    address: str
    notes: tuple[str, ...] = ()


class Link(Protocol):
    """One way to a camera, used for one connection. Every method may raise DeviceError."""

    def open(self) -> Linked:
        """Find the camera that is meant, and take control of it.

        Raises
        ------
        DeviceError
            There is none, or several, or it cannot be used: the text says why and what to do.
        """
        ...

    def prepare(self, settings: GenicamSettings) -> Mapping[str, object]:
        """Set what the stream keeps from its making on; return what was granted."""
        ...

    def prepare_stream(self, stream: int) -> None:
        """Set what belongs to the stream, before it gets its buffers."""
        ...

    def answers(self, heard_s: float) -> bool:
        """Return whether the camera answers now.

        Parameters
        ----------
        heard_s : monotonic time at which it last answered or sent an image

        Raises
        ------
        DeviceLost
            It is gone, or no longer ours.
        """
        ...

    def is_ours(self) -> bool:
        """Return whether the camera would take an order to stop."""
        ...

    def read_clock(self) -> ClockReading | None:
        """Read the camera's clock; None where it has none.

        Raises
        ------
        DeviceError
            It cannot be read.
        """
        ...

    def health(self, stream: int) -> Mapping[str, Any]:
        """Return what the link counts."""
        ...
