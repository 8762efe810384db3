"""Cameras that describe themselves by GenICam, through Aravis, whatever link they hang on."""

import time
from collections.abc import Mapping
from ctypes import byref, c_int, c_uint64
from typing import Any

import numpy as np

from omm_camera_driver.clocks import WallClock
from omm_camera_driver.driver import Camera, CameraSettings, DeviceLost, Frame
from omm_camera_driver.drivers.genicam import aravis
from omm_camera_driver.drivers.genicam.camera_clock import CameraClock
from omm_camera_driver.drivers.genicam.link import Link
from omm_camera_driver.drivers.genicam.settings import GenicamSettings
from omm_camera_driver.pixels import mono_from_genicam
from omm_core.errors import DeviceError, OmmError

_BUFFERS = 10
_CLOCK_PERIOD_S = 5.0


class GenicamDriver:
    """One connection to one camera.

    Parameters
    ----------
    link : how to reach it
    ptp : let the camera keep PTP time
    wall : the system's clock
    """

    def __init__(self, link: Link, *, ptp: bool = False, wall: WallClock | None = None) -> None:
        self._link = link
        self._ptp = ptp
        self._arv = aravis.load()
        self._camera: int | None = None
        self._stream: int | None = None
        self._buffers: dict[int, np.ndarray] = {}
        self._held: int | None = None
        self._wall = wall or WallClock()
        self._clock = CameraClock()
        self._clock_read_s = 0.0
        self._heard_s = 0.0
        self._exposure_ns = 0
        self._camera_health: Mapping[str, Any] = {}
        self._wraps = 0
        self._last_id = 0

    def open(self, settings: CameraSettings) -> Camera:
        """Find the camera, connect, apply the settings and make the stream."""
        linked = self._link.open()
        self._camera = linked.handle
        device = self._arv.camera_get_device(self._camera)
        self._arv.device_set_range_check_policy(device, aravis.RANGE_CHECK_ENABLE)
        self._settings = GenicamSettings(self._arv, self._camera, device)
        notes = self._settings.apply(settings, ptp=self._ptp)
        self._exposure_ns = self._settings.exposure_ns()
        granted = self._link.prepare(self._settings)
        self._make_stream()
        self._read_clock(times=5)
        self._camera_health = self._settings.health()
        self._heard_s = time.monotonic()
        return Camera(
            vendor=linked.vendor,
            model=linked.model,
            serial=linked.serial,
            address=linked.address,
            has_software_trigger=bool(self._arv.camera_is_software_trigger_supported(self._camera)),
            granted={**self._settings.granted(), **granted},
            notes=(*linked.notes, *notes),
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
        self._heard_s = time.monotonic()
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
        """Ask the camera whether it is still there, and now and then what its clock says."""
        if not self._link.answers(self._heard_s):
            return
        self._heard_s = time.monotonic()
        if time.monotonic() - self._clock_read_s > _CLOCK_PERIOD_S:
            self._read_clock(times=2)
            self._camera_health = self._settings.health()
            self._exposure_ns = self._settings.exposure_ns()  # an automatic may have changed it

    def set(self, name: str, value: float) -> float:
        """Change exposure or gain, checked against the camera's range."""
        granted = self._settings.set(name, value)
        self._exposure_ns = self._settings.exposure_ns()
        return granted

    def health(self) -> Mapping[str, Any]:
        """Return what the stream counted, and the camera's temperature."""
        if self._stream is None:
            return {}
        completed, failed, underruns = c_uint64(), c_uint64(), c_uint64()
        self._arv.stream_get_statistics(
            self._stream, byref(completed), byref(failed), byref(underruns)
        )
        return {
            "frames_received": completed.value,
            "frames_failed": failed.value,
            "packets_without_buffer": underruns.value,
            **self._link.health(self._stream),
            "clock": self._clock.told(),
            **self._camera_health,
        }

    def close(self) -> None:
        """Stop and release everything; this blocks for seconds when the camera is gone."""
        if self._camera is None:
            return
        try:
            if self._stream is not None and self._link.is_ours():
                self._arv.camera_stop_acquisition(self._camera)
        except OmmError:
            # It is gone: then there is nothing to stop.
            self._heard_s = 0.0
        self._release()
        if self._stream is not None:
            self._arv.g_object_unref(self._stream)  # ends its thread, and lets go of the buffers
            self._stream = None
        self._arv.g_object_unref(self._camera)
        self._camera = None
        self._buffers.clear()

    def _make_stream(self) -> None:
        arv = self._arv
        self._stream = arv.camera_create_stream(self._camera, None, None)
        self._link.prepare_stream(self._stream)
        payload = arv.camera_get_payload(self._camera)
        for _ in range(_BUFFERS):
            memory = np.zeros(payload, np.uint8)
            buffer = arv.buffer_new(payload, memory.ctypes.data)
            self._buffers[buffer] = memory
            arv.stream_push_buffer(self._stream, buffer)

    def _release(self) -> None:
        if self._held is not None:
            held, self._held = self._held, None
            self._arv.stream_push_buffer(self._stream, held)

    def _pixels(self, buffer: int) -> "np.ndarray[Any, Any]":
        across, down = c_int(), c_int()
        self._arv.buffer_get_image_padding(buffer, byref(across), byref(down))
        return mono_from_genicam(
            self._buffers[buffer],
            self._arv.buffer_get_image_pixel_format(buffer),
            self._arv.buffer_get_image_width(buffer),
            self._arv.buffer_get_image_height(buffer),
            row_padding=across.value,
        )

    def _count(self, buffer: int) -> int:
        """Return the frame's number without the wrap of GigE's 16 bits (which leaves 0 out)."""
        frame_id = self._arv.buffer_get_frame_id(buffer)
        if frame_id < self._last_id - 0x8000:
            self._wraps += 1
        self._last_id = frame_id
        return int(frame_id) + 0xFFFF * self._wraps

    def _stamp(self, buffer: int) -> tuple[int, int]:
        """Return the system time of the exposure's beginning, and how far off it may be."""
        step = self._wall.look()
        now_ns = self._wall.monotonic_ns()
        # Aravis stamps arrivals by the wall clock. Across a step, it can only be "before now".
        arrival_ns = self._wall.monotonic_of(self._arv.buffer_get_system_timestamp(buffer))
        if step is not None or arrival_ns > now_ns:
            arrival_ns = now_ns
        if step is not None and step.slept_ns:
            self._clock.forget()
            self._read_clock(times=5)
        stamped = (self._arv.buffer_get_timestamp(buffer), arrival_ns, self._exposure_ns)
        if not self._clock.can_be(*stamped):
            # Its clock was set since it was read, or counts in another unit than its stamps.
            self._clock.forget()
            self._read_clock(times=5)
            if not self._clock.can_be(*stamped):
                self._clock.distrust()
        begin_ns, bound_ns = self._clock.exposure_begin(*stamped)
        return self._wall.system_ns(begin_ns), bound_ns

    def _read_clock(self, times: int) -> None:
        self._clock_read_s = time.monotonic()
        try:
            for _ in range(times):
                reading = self._link.read_clock()
                if reading is None:
                    return
                self._clock.add_reading(reading)
        except DeviceError as error:
            # Optional in both standards: then the arrivals have to do.
            self._clock.unread = str(error)
