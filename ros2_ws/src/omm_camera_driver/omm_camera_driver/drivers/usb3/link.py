"""The link to a USB3 Vision camera."""

from collections.abc import Mapping
from ctypes import byref, c_uint32
from typing import Any

from omm_camera_driver.driver import DeviceLost
from omm_camera_driver.drivers.genicam import library
from omm_camera_driver.drivers.genicam.camera_clock import ClockReading, timed
from omm_camera_driver.drivers.genicam.link import Linked
from omm_camera_driver.drivers.usb3.finding import choose, listed, seen_as
from omm_camera_driver.drivers.usb3.sysfs import PluggedCamera, plugged
from omm_core.errors import DeviceError

# GenCP bootstrap registers: version, and the camera's time (ticks, order to note it, ns per tick).
_VERSION = 0x0000
_TIMESTAMP, _TIMESTAMP_LATCH, _TICK_NS = 0x01F0, 0x01F8, 0x01FC


class Usb3Link:
    """One connection to one USB3 Vision camera.

    Parameters
    ----------
    device : serial number, GUID or model; empty: the only one there is
    """

    def __init__(self, device: str = "") -> None:
        self._wanted = device
        self._arv = library.load()
        self._device = 0
        self._plugged: PluggedCamera | None = None

    def interface(self) -> int:
        """Return Aravis' interface that lists the cameras."""
        if not hasattr(self._arv, "uv_interface_get_instance"):
            raise DeviceError(
                f"Expected a {library.LIBRARY} with USB3 Vision, but this one was built without. "
                f"On Debian and Ubuntu: sudo apt install {library.PACKAGE}"
            )
        return int(self._arv.uv_interface_get_instance())

    def open(self) -> Linked:
        """Find the camera and claim it."""
        interface, seen = self.interface(), plugged()
        found = choose(self._wanted, listed(self._arv, interface), seen)
        self._plugged = seen_as(found, seen)
        try:
            self._device = self._arv.interface_open_device(interface, found.key.encode())
        except DeviceError as error:
            raise DeviceError(
                f"{found} cannot be opened: {error}. Close any other program that uses it."
            ) from error
        try:
            handle = self._arv.camera_new_with_device(self._device)
        finally:
            self._arv.g_object_unref(self._device)  # the camera keeps it
        return Linked(
            handle=handle,
            vendor=found.vendor,
            model=found.model,
            serial=found.serial,
            address=self._plugged.port if self._plugged else found.key,
        )

    def prepare(self) -> Mapping[str, object]:
        """Return the speed of the port; there is nothing to agree on."""
        return self._speed()

    def prepare_stream(self, stream: int) -> None:
        """Leave the stream as it is: USB loses no packets that could be asked for again."""

    def answers(self, heard_s: float) -> bool:
        """Read a register that every camera has."""
        try:
            self._register(_VERSION)
        except DeviceError as error:
            raise DeviceLost(
                f"The camera does not answer ({error}). Check cable, power and USB port."
            ) from error
        return True

    def is_ours(self) -> bool:
        """Return True: who has opened the device is the only one who can."""
        return True

    def read_clock(self) -> ClockReading | None:
        """Have the camera note its time, between the asking and the answer."""
        tick_ns = self._long(_TICK_NS)
        with timed() as period:
            self._arv.device_write_register(self._device, _TIMESTAMP_LATCH, 1)
        ticks = self._long(_TIMESTAMP)
        if not ticks or not tick_ns:
            raise DeviceError("The camera has no clock.")
        return period.reading(ticks * tick_ns)

    def health(self, stream: int) -> Mapping[str, Any]:
        """Return the speed of the port, and what is wrong with it."""
        slow = self._plugged.slow() if self._plugged else ""
        return {**self._speed(), **({"usb": slow} if slow else {})}

    def _speed(self) -> dict[str, object]:
        return {"usb_mbps": self._plugged.speed_mbps} if self._plugged else {}

    def _register(self, address: int) -> int:
        value = c_uint32()
        self._arv.device_read_register(self._device, address, byref(value))
        return value.value

    def _long(self, address: int) -> int:
        return self._register(address + 4) << 32 | self._register(address)
