"""Which video devices are there, which one is meant, and why one cannot be used."""

import errno
import os
from dataclasses import dataclass
from pathlib import Path

from omm_camera_driver.drivers.v4l2 import videodev
from omm_core.errors import DeviceError


@dataclass(frozen=True, kw_only=True)
class FoundDevice:
    """A video device.

    Attributes
    ----------
    problem : str
        Why it cannot be used; empty if it can.
    """

    path: str
    driver: str
    card: str
    bus: str
    problem: str = ""


def devices() -> list[FoundDevice]:
    """Return every /dev/video node, and why it cannot be used where it cannot."""
    return [_look_at(str(path)) for path in sorted(Path("/dev").glob("video*"))]


def find(device: str) -> FoundDevice:
    """Return the device that is meant by a path, a card's name, a bus, or nothing.

    Raises
    ------
    DeviceError
        There is none that can be used, or several.
    """
    there = devices()
    meant = [d for d in there if device in (d.path, d.card, d.bus)] if device else there
    usable = [d for d in meant if not d.problem]
    if len(usable) > 1 and len({(d.bus, d.card) for d in usable}) > 1:
        told = ", ".join(f"{d.path} ({d.card})" for d in usable)
        raise DeviceError(
            f"Expected one video device, found {told}. Name one in the parameter device."
        )
    if usable:
        return usable[0]
    if device and os.path.exists(device):
        looked = _look_at(device)
        if not looked.problem:
            return looked
        meant = [looked]
    told = "; ".join(f"{d.path}: {d.problem or d.card}" for d in meant or there)
    called = f" {device}" if device else ""
    raise DeviceError(
        f"Expected a video device{called}, found {told or 'none'}. Is it plugged in, and its "
        "kernel module loaded (./omm cameras)?"
    )


def _look_at(path: str) -> FoundDevice:
    nothing = FoundDevice(path=path, driver="", card="", bus="")
    try:
        fd = open_device(path)
    except DeviceError as error:
        return FoundDevice(**{**vars(nothing), "problem": str(error)})
    try:
        capability = videodev.call(fd, videodev.QUERYCAP, videodev.Capability())
    except DeviceError as error:
        return FoundDevice(**{**vars(nothing), "problem": str(error)})
    finally:
        os.close(fd)
    has_own = capability.capabilities & videodev.CAP_DEVICE_CAPS
    caps = capability.device_caps if has_own else capability.capabilities
    captures = caps & videodev.CAP_VIDEO_CAPTURE and caps & videodev.CAP_STREAMING
    return FoundDevice(
        path=path,
        driver=capability.driver.decode("utf-8", "replace"),
        card=capability.card.decode("utf-8", "replace"),
        bus=capability.bus_info.decode("utf-8", "replace"),
        problem="" if captures else "it does not capture images",
    )


def open_device(path: str) -> int:
    """Open a video device.

    Raises
    ------
    DeviceError
        It cannot be opened; the text says what to do about missing rights.
    """
    try:
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        hint = ""
        if error.errno == errno.EACCES:
            hint = " (sudo usermod -aG video $USER, then log in again)"
        raise DeviceError(f"cannot be opened: {error.strerror}{hint}") from error
