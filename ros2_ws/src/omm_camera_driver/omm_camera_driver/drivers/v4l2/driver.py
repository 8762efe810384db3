"""Video4Linux cameras: USB cameras, and every other with a /dev/video node."""

import mmap
import os
import select
import time
from collections.abc import Mapping
from ctypes import c_int
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_camera_driver.clocks import read_clocks
from omm_camera_driver.driver import Camera, CameraSettings, DeviceLost, Frame, Trigger
from omm_camera_driver.drivers.v4l2 import videodev
from omm_camera_driver.drivers.v4l2.controls import Controls
from omm_camera_driver.drivers.v4l2.devices import find, open_device
from omm_camera_driver.drivers.v4l2.sizes import smaller_than_it_can
from omm_camera_driver.pixels import mono_from_yuyv
from omm_core.errors import DeviceError, InputError

_BUFFERS = 6
# Monochrome without loss first.
_PREFERRED = ("GREY", "Y16", "YUYV", "MJPG")
_STAMP_JITTER_NS = 1_000_000  # between the event and the driver's reading of the clock


class V4l2Driver:
    """One connection to one V4L2 device.

    Parameters
    ----------
    device : path, card's name or bus; empty: the first that captures
    readout_ns : from the end of the exposure to the driver's stamp, 0 where it is not known
    """

    def __init__(self, device: str = "", *, readout_ns: int = 0) -> None:
        self._device = device
        self._readout_ns = readout_ns
        self._fd = -1
        self._maps: list[mmap.mmap] = []
        self._pix = videodev.PixelFormat()
        self._interval_ns = 0
        self._exposure_ns = 0
        self._errors = 0

    def open(self, settings: CameraSettings) -> Camera:
        """Open the device, agree on format and rate, set the controls, map the buffers."""
        if settings.trigger is Trigger.HARDWARE:
            raise InputError(
                "Expected the trigger to be continuous or software: V4L2 has no lines."
            )
        found = find(self._device)
        self._fd = open_device(found.path)
        self._pix = self._agree_on_format(settings)
        self._interval_ns = self._agree_on_interval(settings.frame_rate_hz)
        self._controls = Controls(self._fd)
        for name in ("exposure_us", "gain"):
            value = getattr(settings, name)
            if value is not None:
                self._controls.set(name, value)
        if settings.black_level is not None:
            self._controls.set_named("black_level", round(settings.black_level))
        notes = self._controls.take_back(keep=settings.controls)
        for name, text in settings.controls.items():
            self._controls.set_named(name, _integer(name, text))
        self._exposure_ns = self._controls.exposure_ns()
        self._map_buffers()
        granted: dict[str, object] = {
            "pixel_format": videodev.letters(self._pix.pixelformat),
            "size_px": f"{self._pix.width}x{self._pix.height}",
            "exposure_us": self._exposure_ns / 1000,
            "frame_rate_hz": round(1e9 / self._interval_ns, 3) if self._interval_ns else 0.0,
        }
        return Camera(
            vendor=found.driver, model=found.card, serial=found.bus, address=found.path,
            has_software_trigger=False, granted=granted,
            notes=(*notes, *smaller_than_it_can(self._fd, self._pix, settings)),
        )  # fmt: skip

    def start(self) -> None:
        """Queue all buffers and let the device fill them."""
        for index in range(len(self._maps)):
            self._queue(index)
        videodev.call(self._fd, videodev.STREAMON, c_int(videodev.CAPTURE))

    def flush(self) -> None:
        """Return every filled buffer to the driver's queue."""
        while self._readable(0.0):
            self._queue(self._dequeue().index)

    def trigger(self) -> None:
        """Do nothing: V4L2 knows no trigger, the worker takes the next image instead."""
        raise DeviceError("A V4L2 device cannot be triggered.")

    def next_frame(self, timeout_s: float) -> Frame | None:
        """Return the next buffer, whole or not."""
        if not self._readable(timeout_s):
            return None
        buffer = self._dequeue()
        image = self._image(buffer)
        self._queue(buffer.index)
        complete = image is not None
        self._errors += not complete
        mid_ns, uncertainty_ns = exposure_middle(
            buffer.timestamp_ns + read_clocks().offset_ns,
            at_start=buffer.flags & videodev.STAMPED_AT_MASK
            == videodev.STAMPED_AT_START_OF_EXPOSURE,
            exposure_ns=self._exposure_ns,
            readout_ns=self._readout_ns,
            interval_ns=self._interval_ns,
        )
        if buffer.flags & videodev.TIMESTAMP_MASK != videodev.TIMESTAMP_MONOTONIC:
            # The driver's stamp is of no known clock: what is left is "before now".
            mid_ns, uncertainty_ns = time.time_ns() - self._interval_ns, 2 * self._interval_ns
        return Frame(
            image=image if image is not None else np.zeros((0, 0), np.uint8),
            exposure_mid_ns=mid_ns,
            exposure_ns=self._exposure_ns,
            stamp_uncertainty_ns=uncertainty_ns,
            sequence=buffer.sequence,
            complete=complete,
        )

    def check(self) -> None:
        """Ask the device who it is."""
        videodev.call(self._fd, videodev.QUERYCAP, videodev.Capability())

    def set(self, name: str, value: float) -> float:
        """Change exposure or gain, checked against the device's range."""
        granted = self._controls.set(name, value)
        self._exposure_ns = self._controls.exposure_ns()
        return granted

    def health(self) -> Mapping[str, Any]:
        """Return the number of damaged buffers, and the time to read one out."""
        return {"damaged_buffers": self._errors, "readout_ms": self._readout_ns / 1e6}

    def close(self) -> None:
        """Stop, unmap and close."""
        if self._fd < 0:
            return
        try:
            videodev.call(self._fd, videodev.STREAMOFF, c_int(videodev.CAPTURE))
        except DeviceError:
            # Gone: closing the file frees what the kernel holds.
            self._errors += 1
        for mapped in self._maps:
            mapped.close()
        self._maps.clear()
        os.close(self._fd)
        self._fd = -1

    def _agree_on_format(self, settings: CameraSettings) -> videodev.PixelFormat:
        if settings.offset_x_px or settings.offset_y_px:
            raise InputError("Expected roi_x_px and roi_y_px 0: a V4L2 device has sizes only.")
        there = _formats(self._fd)
        wanted = settings.pixel_format or next((f for f in _PREFERRED if f in there), "")
        if wanted not in there or wanted not in _PREFERRED:
            usable = [f for f in there if f in _PREFERRED]
            raise InputError(
                f"Expected pixel_format to be one of {', '.join(usable) or 'none'}, which this"
                f" device has and omm reads, got {wanted or ', '.join(there)}."
            )
        form = videodev.call(self._fd, videodev.G_FMT, videodev.Format(type=videodev.CAPTURE))
        pix = form.fmt.pix
        asked = (settings.width_px or pix.width, settings.height_px or pix.height)
        pix.width, pix.height = asked
        pix.pixelformat = videodev.fourcc(wanted)
        pix.bytesperline = pix.sizeimage = 0
        pix = videodev.call(self._fd, videodev.S_FMT, form).fmt.pix
        got = (pix.width, pix.height, videodev.letters(pix.pixelformat))
        if got != (*asked, wanted):
            raise InputError(
                f"Expected a size that this device has, got {asked[0]} × {asked[1]} {wanted}; the "
                f"nearest is {got[0]} × {got[1]} {got[2]} (roi_width_px, roi_height_px)."
            )
        return pix

    def _agree_on_interval(self, rate_hz: float | None) -> int:
        """Ask for a frame rate; what counts is the interval that is granted (ns)."""
        parameters = videodev.StreamParameters(type=videodev.CAPTURE)
        videodev.call(self._fd, videodev.G_PARM, parameters)
        capture = parameters.parm.capture
        if rate_hz is not None and capture.capability & videodev.CAN_SET_INTERVAL:
            capture.timeperframe.numerator = 1000
            capture.timeperframe.denominator = round(rate_hz * 1000)
            videodev.call(self._fd, videodev.S_PARM, parameters)
        granted = parameters.parm.capture.timeperframe
        if not granted.denominator:
            return 0
        return round(1e9 * granted.numerator / granted.denominator)

    def _map_buffers(self) -> None:
        request = videodev.RequestBuffers(
            count=_BUFFERS, type=videodev.CAPTURE, memory=videodev.MMAP
        )
        for index in range(videodev.call(self._fd, videodev.REQBUFS, request).count):
            buffer = self._buffer(index)
            videodev.call(self._fd, videodev.QUERYBUF, buffer)
            self._maps.append(mmap.mmap(self._fd, buffer.length, offset=buffer.m.offset))

    def _buffer(self, index: int = 0) -> videodev.Buffer:
        return videodev.Buffer(index=index, type=videodev.CAPTURE, memory=videodev.MMAP)

    def _queue(self, index: int) -> None:
        videodev.call(self._fd, videodev.QBUF, self._buffer(index))

    def _dequeue(self) -> videodev.Buffer:
        buffer: videodev.Buffer = videodev.call(self._fd, videodev.DQBUF, self._buffer())
        return buffer

    def _readable(self, timeout_s: float) -> bool:
        poll = select.poll()
        poll.register(self._fd, select.POLLIN | select.POLLPRI)
        events = poll.poll(timeout_s * 1000)
        if events and events[0][1] & (select.POLLERR | select.POLLHUP | select.POLLNVAL):
            self.check()  # tells why, if it is gone
            raise DeviceLost("The video device stopped delivering.")
        return bool(events)

    def _image(self, buffer: videodev.Buffer) -> NDArray[np.generic] | None:
        """Return the image in a buffer; None where it is damaged."""
        if buffer.flags & videodev.BUFFER_ERROR:
            return None
        data = np.frombuffer(memoryview(self._maps[buffer.index])[: buffer.bytesused], np.uint8)
        return mono_image(data, self._pix)


def mono_image(data: NDArray[np.uint8], pix: videodev.PixelFormat) -> NDArray[np.generic] | None:
    """Return the image (height, width) of raw data, copied; None where they are cut short.

    Copied, because a mapping cannot be closed while an image lies in it, and the device stays busy
    until all are closed.
    """
    name, width, height = videodev.letters(pix.pixelformat), pix.width, pix.height
    if name == "MJPG":
        return _mono_from_jpeg(data, width, height)
    row_bytes = pix.bytesperline or width * (1 if name == "GREY" else 2)
    if len(data) < row_bytes * height:
        return None
    if name == "YUYV":
        return mono_from_yuyv(data, width, height, row_bytes)
    rows = data[: row_bytes * height].reshape(height, row_bytes)
    if name == "GREY":
        return rows[:, :width].copy()
    return rows[:, : 2 * width].copy().view("<u2")


def _mono_from_jpeg(data: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8] | None:
    import cv2

    end = data[-64:].tobytes().rstrip(b"\0")  # some cameras pad
    if data[:2].tobytes() != b"\xff\xd8" or not end.endswith(b"\xff\xd9"):
        return None
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    return None if image is None or image.shape != (height, width) else image


def exposure_middle(
    stamp_ns: int, *, at_start: bool, exposure_ns: int, readout_ns: int, interval_ns: int
) -> tuple[int, int]:
    """Return the exposure's middle and how far off it may be (ns), from the driver's stamp.

    A stamp is of the start of the exposure, or of the end of the frame: then the readout lies
    between. Where its duration is not known, it is anything up to a frame's interval.
    """
    unknown_ns = 0 if exposure_ns else interval_ns // 2
    if at_start:
        return stamp_ns + exposure_ns // 2, _STAMP_JITTER_NS + unknown_ns
    if readout_ns:
        return stamp_ns - readout_ns - exposure_ns // 2, _STAMP_JITTER_NS + unknown_ns
    half_ns = interval_ns // 2
    return stamp_ns - half_ns - exposure_ns // 2, _STAMP_JITTER_NS + half_ns + unknown_ns


def _formats(fd: int) -> list[str]:
    names: list[str] = []
    while True:
        description = videodev.FormatDescription(index=len(names), type=videodev.CAPTURE)
        try:
            videodev.call(fd, videodev.ENUM_FMT, description)
        except DeviceLost:
            raise
        except DeviceError:  # that was the last one
            return names
        names.append(videodev.letters(description.pixelformat))


def _integer(name: str, text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        raise InputError(f"controls: expected an integer for {name}, got {text!r}.") from None
