"""The link to a USB3 Vision camera."""

import time
from collections.abc import Mapping
from ctypes import byref, c_uint32
from dataclasses import dataclass
from typing import Any

from omm_camera_driver.driver import DeviceLost
from omm_camera_driver.drivers.genicam import aravis
from omm_camera_driver.drivers.genicam.camera_clock import ClockReading
from omm_camera_driver.drivers.genicam.link import Linked
from omm_camera_driver.drivers.genicam.settings import GenicamSettings
from omm_camera_driver.drivers.usb3.finding import choose, listed, seen_as
from omm_camera_driver.drivers.usb3.sysfs import PluggedCamera, plugged
from omm_core.errors import DeviceError, InputError

# GenCP 1.3.1, 5.4: version, the camera's time in ns, and the order to note it. (The register that
# follows, ns per tick, only says how finely the time goes on.)
_VERSION = 0x0000
_TIMESTAMP, _TIMESTAMP_LATCH = 0x01F0, 0x01F8
# SFNC: the same as features. Where a camera has them, they are of the clock that stamps its images.
_CLOCK_FEATURES = ("TimestampLatch", "TimestampLatchValue")
_LIMIT, _LIMIT_MODE = "DeviceLinkThroughputLimit", "DeviceLinkThroughputLimitMode"


@dataclass(frozen=True, kw_only=True)
class Usb3Options:
    """How to reach the camera.

    Attributes
    ----------
    device : str
        Serial number, GUID, model or port; empty: the only one there is.
    mode : str
        How Aravis reads from the bus: async or sync.
    bandwidth_mb_per_s : float
        What the camera may send at most; 0 leaves it.
    """

    device: str = ""
    mode: str = "async"
    bandwidth_mb_per_s: float = 0.0


class Usb3Link:
    """One connection to one USB3 Vision camera."""

    def __init__(self, options: Usb3Options) -> None:
        self._options = options
        self._arv = aravis.load()
        self._camera = self._device = 0
        self._lost = False
        self._has_clock_features = False
        self._plugged: PluggedCamera | None = None

    def interface(self) -> int:
        """Return Aravis' interface that lists the cameras."""
        if not hasattr(self._arv, "uv_interface_get_instance"):
            raise DeviceError(
                f"Expected a {aravis.LIBRARY} with USB3 Vision, but this one was built without. "
                f"On Debian and Ubuntu: sudo apt install {aravis.PACKAGE}"
            )
        return int(self._arv.uv_interface_get_instance())

    def open(self) -> Linked:
        """Find the camera and claim it."""
        interface, seen = self.interface(), plugged()
        found = choose(self._options.device, listed(self._arv, interface), seen)
        self._plugged = seen_as(found, seen)
        try:
            self._device = self._arv.interface_open_device(interface, found.key.encode())
        except DeviceError as error:
            advice = (
                "another program holds it: close that program"
                if "BUSY" in str(error)
                else "plug it in again; it may hang on a hub without enough power"
            )
            raise DeviceError(f"{found} cannot be opened ({error}): {advice}.") from error
        if not self._device:
            raise DeviceError(f"{found} went away while it was being opened.")
        try:
            self._camera = self._arv.camera_new_with_device(self._device)
        finally:
            self._arv.g_object_unref(self._device)  # the camera keeps it
        slow = self._plugged.slow() if self._plugged else ""
        return Linked(
            handle=self._camera,
            vendor=found.vendor,
            model=found.model,
            serial=found.serial,
            address=self._plugged.port if self._plugged else found.key,
            notes=(f"The camera is {slow}.",) if slow else (),
        )

    def prepare(self, settings: GenicamSettings) -> Mapping[str, object]:
        """Choose how the bus is read, and limit what the camera sends."""
        self._has_clock_features = all(settings.has(name) for name in _CLOCK_FEATURES)
        if self._arv.camera_is_uv_device(self._camera):
            self._arv.camera_uv_set_usb_mode(self._camera, aravis.USB_MODES[self._options.mode])
        if not self._options.bandwidth_mb_per_s:
            return self._speed()
        if not settings.has(_LIMIT):
            raise InputError(
                f"Expected usb_bandwidth_mb_per_s to be left unset: this camera has no {_LIMIT}."
            )
        if settings.has(_LIMIT_MODE):  # first: while it is off, many cameras lock the limit
            settings.put(_LIMIT_MODE, "On")
        wanted = round(self._options.bandwidth_mb_per_s * 1e6)
        granted = settings.set_integer(_LIMIT, wanted, "B/s") / 1e6
        return {**self._speed(), "usb_bandwidth_mb_per_s": granted}

    def prepare_stream(self, stream: int) -> None:
        """Leave the stream as it is: USB loses no packets that could be asked for again."""

    def answers(self, heard_s: float) -> bool:
        """Read a register that every camera has."""
        try:
            self._register(_VERSION)
        except DeviceError as error:
            self._lost = True
            raise DeviceLost(
                f"The camera does not answer ({error}). Check cable, power and USB port."
            ) from error
        return True

    def is_ours(self) -> bool:
        """Return whether it has answered so far: who has opened the device is the only one."""
        return not self._lost

    def read_clock(self) -> ClockReading | None:
        """Have the camera note its time, between the asking and the answer."""
        command, value = (name.encode() for name in _CLOCK_FEATURES)
        after_ns = time.monotonic_ns()
        if self._has_clock_features:
            self._arv.camera_execute_command(self._camera, command)
        else:
            self._arv.device_write_register(self._device, _TIMESTAMP_LATCH, 1)
        before_ns = time.monotonic_ns()
        if self._has_clock_features:
            camera_ns = int(self._arv.camera_get_integer(self._camera, value))
        else:
            camera_ns = self._long(_TIMESTAMP)
        if not camera_ns:
            raise DeviceError("the camera's clock stands still")
        return ClockReading(camera_ns=camera_ns, after_ns=after_ns, before_ns=before_ns)

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
