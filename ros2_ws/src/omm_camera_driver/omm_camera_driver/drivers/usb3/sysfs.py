"""Which USB3 Vision cameras are plugged in, as the kernel knows them.

The kernel tells every device's names without any right to use it, and Aravis lists only those that
it may open: that is how a camera that cannot be used is told from one that is absent.
"""

import os
from dataclasses import dataclass
from pathlib import Path

_DEVICES = Path("/sys/bus/usb/devices")
_NODES = Path("/dev/bus/usb")
# The control interface of USB3 Vision: class "miscellaneous", subclass and protocol of its own.
_CONTROL = ("ef", "05", "00")
_USB3_MBPS = 5000
UDEV_RULE = "70-omm-usb3-vision.rules"


@dataclass(frozen=True, kw_only=True)
class PluggedCamera:
    """A USB3 Vision camera that is plugged in.

    Attributes
    ----------
    serial : str
        As its USB descriptor has it: with some makers the GUID, not the number on the label.
    port : str
        The kernel's name of the place: 2-1.4.
    node : Path
        What must be writable.
    speed_mbps : int
        0 where the kernel does not tell it.
    """

    vendor: str
    model: str
    serial: str
    port: str
    node: Path
    speed_mbps: int

    def problem(self) -> str:
        """Return why it cannot be used; empty if it can."""
        if not self.node.exists():
            return f"{self.node} is not there (in a container: --device /dev/bus/usb)"
        if not os.access(self.node, os.R_OK | os.W_OK):
            return (
                f"no right to use {self.node}. Install the rule {UDEV_RULE} (docs/cameras.md), "
                "then plug the camera in again"
            )
        return ""

    def slow(self) -> str:
        """Return what is said of a slow port; empty where it is fast."""
        if 0 < self.speed_mbps < _USB3_MBPS:
            return (
                f"linked with {self.speed_mbps} Mb/s only: use a USB 3 port and cable "
                "(blue, or marked SS)"
            )
        return ""


def plugged(devices: Path = _DEVICES, nodes: Path = _NODES) -> list[PluggedCamera]:
    """Return the USB3 Vision cameras that are plugged in.

    Parameters
    ----------
    devices, nodes : where the kernel shows USB devices, and their nodes
    """
    found = []
    for interface in sorted(devices.glob("*:*")):
        names = ("bInterfaceClass", "bInterfaceSubClass", "bInterfaceProtocol")
        if tuple(_text(interface / name).lower() for name in names) != _CONTROL:
            continue
        device = devices / interface.name.split(":")[0]
        bus, number = _number(device / "busnum"), _number(device / "devnum")
        found.append(
            PluggedCamera(
                vendor=_text(device / "manufacturer"),
                model=_text(device / "product"),
                serial=_text(device / "serial"),
                port=device.name,
                node=nodes / f"{bus:03d}" / f"{number:03d}",
                speed_mbps=_number(device / "speed"),
            )
        )
    return found


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:  # not every device has every name, and one may be pulled meanwhile
        return ""


def _number(path: Path) -> int:
    text = _text(path)
    return int(text) if text.isdecimal() else 0
