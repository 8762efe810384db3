"""What a camera driver is: the small interface behind which every camera is used.

A driver stands for one connection to one camera. It is made, opened, started, asked for frames,
stopped, closed, and thrown away; after a loss the worker makes a new one. All of it happens on the
worker's thread (see `worker.py`), so a driver needs no locks and may block for as long as its
device takes. `docs/cameras.md` adds a camera step by step.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import DeviceError


class DeviceLost(DeviceError):
    """The connection is gone: what is left is to close it and to open a new one."""


class FrameLost(DeviceError):
    """One image could not be had; the camera is still there."""


class Trigger(str, Enum):
    """What makes the camera take an image."""

    CONTINUOUS = "continuous"
    SOFTWARE = "software"
    HARDWARE = "hardware"


@dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """What is asked of a camera; None leaves a setting as the camera has it.

    Attributes
    ----------
    exposure_us, frame_rate_hz : float or None
    gain, black_level : float or None
        In the camera's own unit (gain usually dB).
    pixel_format : str or None
        As the device names it (`Mono8`, `GREY`).
    width_px, height_px, offset_x_px, offset_y_px : int or None
        Region of interest.
    trigger : Trigger
    trigger_line, strobe_line : str
        Lines of a hardware trigger and of the ring light; empty means none.
    controls : mapping
        Anything else, by the device's own names.
    """

    exposure_us: float | None = None
    gain: float | None = None
    black_level: float | None = None
    frame_rate_hz: float | None = None
    pixel_format: str | None = None
    width_px: int | None = None
    height_px: int | None = None
    offset_x_px: int | None = None
    offset_y_px: int | None = None
    trigger: Trigger = Trigger.CONTINUOUS
    trigger_line: str = ""
    strobe_line: str = ""
    controls: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Who an opened camera is and what it can.

    Attributes
    ----------
    vendor, model, serial, address : str
    has_software_trigger : bool
        False: the worker keeps the camera running and publishes only what was asked for.
    granted : mapping
        Settings as the camera granted them, read back, by name.
    notes : tuple of str
        What was found otherwise than it should be and is worth knowing; each is logged once.
    """

    vendor: str
    model: str
    serial: str
    address: str
    has_software_trigger: bool
    granted: Mapping[str, object] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.vendor} {self.model} {self.serial} at {self.address}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """One image.

    Attributes
    ----------
    image : (height, width) uint8 or uint16
        Valid until the driver's next call: it may lie in a buffer that the device fills again.
    exposure_mid_ns : int
        Middle of the exposure, system time (ns since the epoch).
    exposure_ns : int
        Its duration; 0 where it is not known.
    stamp_uncertainty_ns : int
        How far off `exposure_mid_ns` may be.
    sequence : int
        The device's count; a gap is a frame that was lost before it got here.
    complete : bool
        False: parts are missing. Such an image is never published.
    """

    image: NDArray[np.generic]
    exposure_mid_ns: int
    exposure_ns: int
    stamp_uncertainty_ns: int
    sequence: int
    complete: bool = True


class CameraDriver(Protocol):
    """One connection to one camera. All methods may raise DeviceLost and DeviceError."""

    def open(self, settings: CameraSettings) -> Camera:
        """Connect and apply the settings.

        Raises
        ------
        DeviceError
            No camera, not usable (told why), or it refuses a setting.
        InputError
            A setting is out of the camera's range; the text names the range.
        """
        ...

    def start(self) -> None:
        """Begin to deliver frames (with a software trigger: to accept triggers)."""
        ...

    def flush(self) -> None:
        """Throw away every frame that has arrived so far."""
        ...

    def trigger(self) -> None:
        """Take one image now (software trigger)."""
        ...

    def next_frame(self, timeout_s: float) -> Frame | None:
        """Return the next image, or None when none came in time."""
        ...

    def check(self) -> None:
        """Raise DeviceLost when the camera is gone; called now and then while nothing arrives."""
        ...

    def set(self, name: str, value: float) -> float:
        """Change `exposure_us` or `gain` while running; return what was granted."""
        ...

    def health(self) -> Mapping[str, Any]:
        """Return figures for the diagnostics: temperature, resent packets and the like."""
        ...

    def close(self) -> None:
        """Stop and release everything, whatever the connection's state; never raise."""
        ...


def check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Raise InputError when a setting is out of the camera's range."""
    from omm_core.errors import InputError

    if not low <= value <= high:
        unit = f" {unit}" if unit else ""
        raise InputError(
            f"Expected {name} from {low:g} to {high:g}{unit}, which this camera allows, "
            f"got {value:g}{unit}."
        )
