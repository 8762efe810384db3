"""GigE Vision cameras, through Aravis."""

import ipaddress
import time
from collections.abc import Mapping
from ctypes import byref, c_uint32, c_uint64
from dataclasses import dataclass
from typing import Any

import numpy as np

from omm_camera_driver.driver import Camera, CameraSettings, DeviceLost, Frame
from omm_camera_driver.drivers.gige import aravis, gvcp
from omm_camera_driver.drivers.gige.camera_clock import CameraClock, ClockReading
from omm_camera_driver.drivers.gige.finding import find, label_of
from omm_camera_driver.drivers.gige.settings import GigeSettings
from omm_camera_driver.pixels import mono_from_genicam
from omm_core.errors import DeviceError, OmmError

_BUFFERS = 10
_CLOCK_PERIOD_S = 5.0
_LOOPBACK_PACKET_BYTES = 65_000
_UNANSWERED_S = 1.0
# GigE Vision bootstrap registers.
_TICK_HIGH, _TICK_LOW = 0x093C, 0x0940
_TIMESTAMP_CONTROL, _TIMESTAMP_HIGH, _TIMESTAMP_LOW = 0x0944, 0x0948, 0x094C
_LATCH = 2
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
    ptp : bool
        Let the camera keep PTP time.
    use_packet_socket : bool
        As root, Aravis reads packets past the UDP stack; False never does.
    """

    device: str = ""
    packet_size_bytes: int = 0
    socket_buffer_bytes: int = 8_000_000
    packet_resend: bool = True
    ptp: bool = False
    use_packet_socket: bool = True


class GigeDriver:
    """One connection to one GigE Vision camera."""

    def __init__(self, options: GigeOptions) -> None:
        self._options = options
        self._arv = aravis.load()
        self._camera: int | None = None
        self._device = 0
        self._stream: int | None = None
        self._buffers: dict[int, np.ndarray] = {}
        self._held: int | None = None
        self._clock = CameraClock()
        self._clock_read_s = 0.0
        self._latches = True
        self._answered_s = 0.0
        self._address = ""
        self._exposure_ns = 0
        self._camera_health: Mapping[str, Any] = {}
        self._wraps = 0
        self._last_id = 0

    def open(self, settings: CameraSettings) -> Camera:
        """Find the camera, connect, apply the settings and make the stream."""
        found = find(self._options.device)
        if _held.setdefault(found.address, gvcp.HeldWatch()).is_held(found.address):
            raise DeviceError(
                f"Expected {label_of(found)} to be free, but another program holds it. Close that "
                "program; a camera that was not released is free again after a few seconds."
            )
        self._address = found.address
        self._camera = self._arv.camera_new(found.address.encode())
        self._device = self._arv.camera_get_device(self._camera)
        self._arv.device_set_range_check_policy(self._device, aravis.RANGE_CHECK_ENABLE)
        self._settings = GigeSettings(self._arv, self._camera, self._device)
        self._settings.apply(settings, ptp=self._options.ptp)
        self._exposure_ns = self._settings.exposure_ns()
        packet_bytes = self._negotiate_packet_size()  # before the stream, which keeps it
        self._make_stream()
        self._read_clock(times=5)
        self._camera_health = self._settings.health()
        self._answered_s = time.monotonic()
        return Camera(
            vendor=found.vendor,
            model=found.model,
            serial=found.serial,
            address=found.address,
            has_software_trigger=bool(self._arv.camera_is_software_trigger_supported(self._camera)),
            granted={**self._settings.granted(), "packet_size_bytes": packet_bytes},
        )

    def start(self) -> None:
        """Let the camera start sending."""
        self._arv.camera_start_acquisition(self._camera)

    def flush(self) -> None:
        """Return every filled buffer to the driver's queue."""
        self._release()
        while buffer := self._arv.stream_try_pop_buffer(self._stream):
            self._count(buffer)
            self._arv.stream_push_buffer(self._stream, buffer)

    def trigger(self) -> None:
        """Send the software trigger."""
        try:
            self._arv.camera_software_trigger(self._camera)
        except DeviceError as error:
            raise DeviceLost(f"The camera does not take the trigger: {error}.") from error

    def next_frame(self, timeout_s: float) -> Frame | None:
        """Return the next buffer, whole or not; it is lent until the next call."""
        self._release()
        buffer = self._arv.stream_timeout_pop_buffer(self._stream, round(timeout_s * 1e6))
        if not buffer:
            return None
        self._held = buffer
        self._answered_s = time.monotonic()
        sequence = self._count(buffer)
        complete = self._arv.buffer_get_status(buffer) == aravis.BUFFER_SUCCESS
        stamp_ns, uncertainty_ns = self._stamp(buffer) if complete else (0, 0)
        return Frame(
            image=self._pixels(buffer) if complete else np.zeros((0, 0), np.uint8),
            exposure_mid_ns=stamp_ns + self._exposure_ns // 2,
            exposure_ns=self._exposure_ns,
            stamp_uncertainty_ns=uncertainty_ns,
            sequence=sequence,
            complete=complete,
        )

    def check(self) -> None:
        """Ask the camera directly: Aravis itself takes six seconds to notice that it is gone."""
        if not self._arv.gv_device_is_controller(self._device):
            raise DeviceLost(
                "The camera is no longer under our control (it was restarted, or cut off)."
            )
        if gvcp.ask(self._address, 0.1) is not None:
            self._answered_s = time.monotonic()
        elif time.monotonic() - self._answered_s > _UNANSWERED_S:
            raise DeviceLost(
                f"The camera at {self._address} does not answer. Check cable, power and network."
            )
        else:
            return
        if gvcp.is_held(self._address) is False:
            raise DeviceLost("The camera was restarted, or ended the connection.")
        if time.monotonic() - self._clock_read_s > _CLOCK_PERIOD_S:
            self._read_clock(times=2)
            self._camera_health = self._settings.health()

    def set(self, name: str, value: float) -> float:
        """Change exposure or gain, checked against the camera's range."""
        granted = self._settings.set(name, value)
        self._exposure_ns = self._settings.exposure_ns()
        return granted

    def health(self) -> Mapping[str, Any]:
        """Return what the stream counted, and the camera's temperature."""
        resent, missing = c_uint64(), c_uint64()
        completed, failed, underruns = c_uint64(), c_uint64(), c_uint64()
        if self._stream is None:
            return {}
        self._arv.gv_stream_get_statistics(self._stream, byref(resent), byref(missing))
        self._arv.stream_get_statistics(
            self._stream, byref(completed), byref(failed), byref(underruns)
        )
        return {
            "frames_received": completed.value,
            "frames_failed": failed.value,
            "packets_without_buffer": underruns.value,
            "packets_resent": resent.value,
            "packets_missing": missing.value,
            "clock": "latched" if self._latches else "from arrivals",
            **self._camera_health,
        }

    def close(self) -> None:
        """Stop and release everything; this blocks for seconds when the camera is gone."""
        if self._camera is None:
            return
        try:
            if self._stream is not None and self._arv.gv_device_is_controller(self._device):
                self._arv.camera_stop_acquisition(self._camera)
        except OmmError:
            # It is gone: then there is nothing to stop.
            self._answered_s = 0.0
        self._release()
        if self._stream is not None:
            self._arv.g_object_unref(self._stream)  # ends its thread, and lets go of the buffers
            self._stream = None
        self._arv.g_object_unref(self._camera)
        self._camera = None
        self._buffers.clear()

    def _make_stream(self) -> None:
        if not self._options.use_packet_socket:
            self._arv.camera_gv_set_stream_options(self._camera, 1)
        self._stream = self._arv.camera_create_stream(self._camera, None, None)
        arv, stream = self._arv, self._stream
        arv.object_set(stream, b"socket-buffer", aravis.SOCKET_BUFFER_FIXED)
        arv.object_set(stream, b"socket-buffer-size", self._options.socket_buffer_bytes)
        resend = aravis.RESEND_ALWAYS if self._options.packet_resend else aravis.RESEND_NEVER
        arv.object_set(stream, b"packet-resend", resend)
        payload = arv.camera_get_payload(self._camera)
        for _ in range(_BUFFERS):
            memory = np.zeros(payload, np.uint8)
            buffer = arv.buffer_new(payload, memory.ctypes.data)
            self._buffers[buffer] = memory
            arv.stream_push_buffer(stream, buffer)

    def _negotiate_packet_size(self) -> int:
        wanted = self._options.packet_size_bytes
        if not wanted and ipaddress.ip_address(self._address).is_loopback:
            wanted = _LOOPBACK_PACKET_BYTES  # a simulated camera, which cannot negotiate
        if wanted:
            self._arv.camera_gv_set_packet_size(self._camera, wanted)
        else:
            self._arv.camera_gv_auto_packet_size(self._camera)
        return int(self._arv.camera_gv_get_packet_size(self._camera))

    def _release(self) -> None:
        if self._held is not None:
            held, self._held = self._held, None
            self._arv.stream_push_buffer(self._stream, held)

    def _pixels(self, buffer: int) -> "np.ndarray[Any, Any]":
        return mono_from_genicam(
            self._buffers[buffer],
            self._arv.buffer_get_image_pixel_format(buffer),
            self._arv.buffer_get_image_width(buffer),
            self._arv.buffer_get_image_height(buffer),
        )

    def _count(self, buffer: int) -> int:
        """Return the frame's number without the wrap at 16 bits (which leaves 0 out)."""
        frame_id = self._arv.buffer_get_frame_id(buffer)
        if frame_id < self._last_id - 0x8000:
            self._wraps += 1
        self._last_id = frame_id
        return int(frame_id) + 0xFFFF * self._wraps

    def _stamp(self, buffer: int) -> tuple[int, int]:
        """Return the system time of the exposure's beginning, and how far off it may be."""
        camera_ns = self._arv.buffer_get_timestamp(buffer)
        arrival_ns = self._arv.buffer_get_system_timestamp(buffer)
        self._clock.add_arrival(camera_ns, arrival_ns)
        return self._clock.system_time(camera_ns, arrival_ns)

    def _read_clock(self, times: int) -> None:
        self._clock_read_s = time.monotonic()
        try:
            ticks_per_s = self._register(_TICK_HIGH) << 32 | self._register(_TICK_LOW)
            for _ in range(times if ticks_per_s else 0):
                self._latch(ticks_per_s)
        except DeviceError:
            # Optional in the protocol: then the arrivals have to do.
            self._latches = False

    def _latch(self, ticks_per_s: int) -> None:
        after_ns = time.time_ns()
        self._arv.device_write_register(self._device, _TIMESTAMP_CONTROL, _LATCH)
        while self._register(_TIMESTAMP_CONTROL) & _LATCH:  # still at it
            if time.time_ns() - after_ns > 50_000_000:
                raise DeviceError("The camera does not latch its clock.")
        before_ns = time.time_ns()
        ticks = self._register(_TIMESTAMP_HIGH) << 32 | self._register(_TIMESTAMP_LOW)
        if ticks == 0:
            raise DeviceError("The camera has no clock.")
        camera_ns = ticks * 1_000_000_000 // ticks_per_s
        self._clock.add_reading(
            ClockReading(camera_ns=camera_ns, after_ns=after_ns, before_ns=before_ns)
        )

    def _register(self, address: int) -> int:
        value = c_uint32()
        self._arv.device_read_register(self._device, address, byref(value))
        return value.value
