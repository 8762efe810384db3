"""The link to a GigE Vision camera."""

import ipaddress
import time
from collections.abc import Mapping
from ctypes import byref, c_uint32, c_uint64
from dataclasses import dataclass
from typing import Any

from omm_camera_driver.driver import DeviceLost
from omm_camera_driver.drivers.genicam import aravis
from omm_camera_driver.drivers.genicam.camera_clock import ClockReading
from omm_camera_driver.drivers.genicam.link import Linked
from omm_camera_driver.drivers.genicam.settings import GenicamSettings
from omm_camera_driver.drivers.gige import gvcp
from omm_camera_driver.drivers.gige.finding import find, label_of
from omm_core.errors import DeviceError

_LOOPBACK_PACKET_BYTES = 65_000
_UNANSWERED_S = 1.0
# GigE Vision bootstrap registers.
_TICK_HIGH, _TICK_LOW = 0x093C, 0x0940
_TIMESTAMP_CONTROL, _TIMESTAMP_HIGH, _TIMESTAMP_LOW = 0x0944, 0x0948, 0x094C
_LATCH = 2
_LATCHED_WITHIN_NS = 50_000_000
_held: dict[str, gvcp.HeldWatch] = {}  # by address, from one connection to the next


@dataclass(frozen=True, kw_only=True)
class GigeOptions:
    """How to reach the camera.

    Attributes
    ----------
    device : str
        Serial number, address, model or user-defined name; empty: the only one there is.
    packet_size_bytes : int
        0 negotiates the largest that arrives.
    socket_buffer_bytes : int
    packet_resend : bool
    use_packet_socket : bool
        As root, Aravis reads packets past the UDP stack; False never does.
    """

    device: str = ""
    packet_size_bytes: int = 0
    socket_buffer_bytes: int = 8_000_000
    packet_resend: bool = True
    use_packet_socket: bool = True


class GigeLink:
    """One connection to one GigE Vision camera."""

    def __init__(self, options: GigeOptions) -> None:
        self._options = options
        self._arv = aravis.load()
        self._camera = self._device = 0
        self._address = ""
        self._ticks_per_s: int | None = None

    def open(self) -> Linked:
        """Find the camera and take control of it."""
        found = find(self._options.device)
        if _held.setdefault(found.address, gvcp.HeldWatch()).is_held(found.address):
            raise DeviceError(
                f"Expected {label_of(found)} to be free, but another program holds it. Close that "
                "program; a camera that was not released is free again after a few seconds."
            )
        self._address = found.address
        self._camera = self._arv.camera_new(found.address.encode())
        self._device = self._arv.camera_get_device(self._camera)
        return Linked(
            handle=self._camera,
            vendor=found.vendor,
            model=found.model,
            serial=found.serial,
            address=found.address,
        )

    def prepare(self, settings: GenicamSettings) -> Mapping[str, object]:
        """Agree on the size of the packets."""
        wanted = self._options.packet_size_bytes
        if not wanted and ipaddress.ip_address(self._address).is_loopback:
            wanted = _LOOPBACK_PACKET_BYTES  # a simulated camera, which cannot negotiate
        if wanted:
            self._arv.camera_gv_set_packet_size(self._camera, wanted)
        else:
            self._arv.camera_gv_auto_packet_size(self._camera)
        if not self._options.use_packet_socket:
            self._arv.camera_gv_set_stream_options(self._camera, 1)
        return {"packet_size_bytes": int(self._arv.camera_gv_get_packet_size(self._camera))}

    def prepare_stream(self, stream: int) -> None:
        """Give the socket its buffer, and say whether lost packets are asked for again."""
        self._arv.object_set(stream, b"socket-buffer", aravis.SOCKET_BUFFER_FIXED)
        self._arv.object_set(stream, b"socket-buffer-size", self._options.socket_buffer_bytes)
        resend = aravis.RESEND_ALWAYS if self._options.packet_resend else aravis.RESEND_NEVER
        self._arv.object_set(stream, b"packet-resend", resend)

    def answers(self, heard_s: float) -> bool:
        """Ask the camera directly: Aravis itself takes six seconds to notice that it is gone."""
        if not self.is_ours():
            raise DeviceLost(
                "The camera is no longer under our control (it was restarted, or cut off)."
            )
        if gvcp.ask(self._address, 0.1) is None:
            if time.monotonic() - heard_s > _UNANSWERED_S:
                raise DeviceLost(
                    f"The camera at {self._address} does not answer. Check cable, power and "
                    "network."
                )
            return False
        if gvcp.is_held(self._address) is False:
            raise DeviceLost("The camera was restarted, or ended the connection.")
        return True

    def is_ours(self) -> bool:
        """Return whether we are the one who controls it."""
        return bool(self._arv.gv_device_is_controller(self._device))

    def read_clock(self) -> ClockReading | None:
        """Have the camera note its time, between the asking and the answer."""
        if self._ticks_per_s is None:
            self._ticks_per_s = self._register(_TICK_HIGH) << 32 | self._register(_TICK_LOW)
        if not self._ticks_per_s:
            return None
        after_ns = time.monotonic_ns()
        self._arv.device_write_register(self._device, _TIMESTAMP_CONTROL, _LATCH)
        while self._register(_TIMESTAMP_CONTROL) & _LATCH:  # still at it
            if time.monotonic_ns() - after_ns > _LATCHED_WITHIN_NS:
                raise DeviceError("the camera does not latch its clock")
        before_ns = time.monotonic_ns()
        ticks = self._register(_TIMESTAMP_HIGH) << 32 | self._register(_TIMESTAMP_LOW)
        if ticks == 0:
            raise DeviceError("the camera's clock stands still")
        camera_ns = ticks * 1_000_000_000 // self._ticks_per_s
        return ClockReading(camera_ns=camera_ns, after_ns=after_ns, before_ns=before_ns)

    def health(self, stream: int) -> Mapping[str, Any]:
        """Return the packets that were asked for again, and those that never came."""
        resent, missing = c_uint64(), c_uint64()
        self._arv.gv_stream_get_statistics(stream, byref(resent), byref(missing))
        return {"packets_resent": resent.value, "packets_missing": missing.value}

    def _register(self, address: int) -> int:
        value = c_uint32()
        self._arv.device_read_register(self._device, address, byref(value))
        return value.value
