"""The part of Linux' videodev2.h that omm uses: structures, requests, and calls that raise.

No library in between: the permissively licensed ones hide the exposure's time stamp, and what is
needed is little.
"""

import ctypes
import errno
import fcntl
from ctypes import c_char, c_int32, c_long, c_uint8, c_uint32
from typing import Any

from omm_camera_driver.driver import DeviceLost
from omm_core.errors import DeviceError

CAPTURE = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
MMAP = 1  # V4L2_MEMORY_MMAP
CAP_VIDEO_CAPTURE, CAP_STREAMING, CAP_DEVICE_CAPS = 0x1, 0x04000000, 0x80000000
CAN_SET_INTERVAL = 0x1000  # V4L2_CAP_TIMEPERFRAME
BUFFER_ERROR = 0x40
SINGLE_SIZE = 1  # V4L2_FRMSIZE_TYPE_DISCRETE
TIMESTAMP_MASK, TIMESTAMP_MONOTONIC = 0xE000, 0x2000
STAMPED_AT_MASK, STAMPED_AT_START_OF_EXPOSURE = 0x70000, 0x10000
CONTROL_DISABLED, CONTROL_NEXT = 0x1, 0x80000000
CONTROL_INTEGER, CONTROL_BOOLEAN, CONTROL_MENU, CONTROL_BUTTON = 1, 2, 3, 4
CONTROL_INTEGER_MENU = 9


def fourcc(name: str) -> int:
    """Return the number of a pixel format's four letters."""
    return int.from_bytes(name.ljust(4).encode("ascii"), "little")


def letters(pixel_format: int) -> str:
    """Return the four letters of a pixel format's number."""
    return pixel_format.to_bytes(4, "little").decode("latin-1").rstrip()


class Capability(ctypes.Structure):
    """What a device is and can do (v4l2_capability)."""

    _fields_ = [
        ("driver", c_char * 16), ("card", c_char * 32), ("bus_info", c_char * 32),
        ("version", c_uint32), ("capabilities", c_uint32), ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    ]  # fmt: skip


class FormatDescription(ctypes.Structure):
    """One pixel format that a device offers (v4l2_fmtdesc)."""

    _fields_ = [
        ("index", c_uint32), ("type", c_uint32), ("flags", c_uint32), ("description", c_char * 32),
        ("pixelformat", c_uint32), ("mbus_code", c_uint32), ("reserved", c_uint32 * 3),
    ]  # fmt: skip


class PixelFormat(ctypes.Structure):
    """Size and layout of an image (v4l2_pix_format)."""

    _fields_ = [
        ("width", c_uint32), ("height", c_uint32), ("pixelformat", c_uint32), ("field", c_uint32),
        ("bytesperline", c_uint32), ("sizeimage", c_uint32), ("colorspace", c_uint32),
        ("priv", c_uint32), ("flags", c_uint32), ("ycbcr_enc", c_uint32),
        ("quantization", c_uint32), ("xfer_func", c_uint32),
    ]  # fmt: skip


class _Stepwise(ctypes.Structure):
    _fields_ = [
        ("min_width", c_uint32), ("max_width", c_uint32), ("step_width", c_uint32),
        ("min_height", c_uint32), ("max_height", c_uint32), ("step_height", c_uint32),
    ]  # fmt: skip


class FrameSize(ctypes.Structure):
    """One size, or a range of sizes, of a format (v4l2_frmsizeenum).

    Of a single one (type 1), `min_width` and `max_width` are its width and height.
    """

    _fields_ = [
        ("index", c_uint32), ("pixel_format", c_uint32), ("type", c_uint32),
        ("sizes", _Stepwise), ("reserved", c_uint32 * 2),
    ]  # fmt: skip

    @property
    def largest(self) -> tuple[int, int]:
        """Width and height of the largest."""
        sizes = self.sizes
        if self.type == SINGLE_SIZE:
            return int(sizes.min_width), int(sizes.max_width)
        return int(sizes.max_width), int(sizes.max_height)


class _FormatUnion(ctypes.Union):
    # The union holds a pointer elsewhere, so it is aligned as one.
    _fields_ = [("pix", PixelFormat), ("raw", c_uint8 * 200), ("align", ctypes.c_void_p)]


class Format(ctypes.Structure):
    """The format of a kind of buffer (v4l2_format)."""

    _fields_ = [("type", c_uint32), ("fmt", _FormatUnion)]


class Fraction(ctypes.Structure):
    """A time per frame, in s (v4l2_fract)."""

    _fields_ = [("numerator", c_uint32), ("denominator", c_uint32)]


class _CaptureParameters(ctypes.Structure):
    _fields_ = [
        ("capability", c_uint32), ("capturemode", c_uint32), ("timeperframe", Fraction),
        ("extendedmode", c_uint32), ("readbuffers", c_uint32), ("reserved", c_uint32 * 4),
    ]  # fmt: skip


class _ParametersUnion(ctypes.Union):
    _fields_ = [("capture", _CaptureParameters), ("raw", c_uint8 * 200)]


class StreamParameters(ctypes.Structure):
    """The frame rate of a stream (v4l2_streamparm)."""

    _fields_ = [("type", c_uint32), ("parm", _ParametersUnion)]


class RequestBuffers(ctypes.Structure):
    """How many buffers a driver is to keep (v4l2_requestbuffers)."""

    _fields_ = [
        ("count", c_uint32), ("type", c_uint32), ("memory", c_uint32), ("capabilities", c_uint32),
        ("flags", c_uint8), ("reserved", c_uint8 * 3),
    ]  # fmt: skip


class _TimeValue(ctypes.Structure):
    _fields_ = [("tv_sec", c_long), ("tv_usec", c_long)]


class _TimeCode(ctypes.Structure):
    _fields_ = [
        ("type", c_uint32), ("flags", c_uint32), ("frames", c_uint8), ("seconds", c_uint8),
        ("minutes", c_uint8), ("hours", c_uint8), ("userbits", c_uint8 * 4),
    ]  # fmt: skip


class _Memory(ctypes.Union):
    _fields_ = [("offset", c_uint32), ("userptr", ctypes.c_ulong)]


class Buffer(ctypes.Structure):
    """One buffer and what is in it (v4l2_buffer)."""

    _fields_ = [
        ("index", c_uint32), ("type", c_uint32), ("bytesused", c_uint32), ("flags", c_uint32),
        ("field", c_uint32), ("timestamp", _TimeValue), ("timecode", _TimeCode),
        ("sequence", c_uint32), ("memory", c_uint32), ("m", _Memory), ("length", c_uint32),
        ("reserved2", c_uint32), ("request_fd", c_int32),
    ]  # fmt: skip

    @property
    def timestamp_ns(self) -> int:
        """The time stamp in ns."""
        return int(self.timestamp.tv_sec) * 1_000_000_000 + int(self.timestamp.tv_usec) * 1000


class Control(ctypes.Structure):
    """The value of a control (v4l2_control)."""

    _fields_ = [("id", c_uint32), ("value", c_int32)]


class ControlDescription(ctypes.Structure):
    """Name, range and type of a control (v4l2_queryctrl)."""

    _fields_ = [
        ("id", c_uint32), ("type", c_uint32), ("name", c_char * 32), ("minimum", c_int32),
        ("maximum", c_int32), ("step", c_int32), ("default_value", c_int32), ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    ]  # fmt: skip


_READ, _WRITE = 2, 1


def _request(direction: int, number: int, kind: Any) -> int:
    return direction << 30 | ctypes.sizeof(kind) << 16 | ord("V") << 8 | number


QUERYCAP = _request(_READ, 0, Capability)
ENUM_FMT = _request(_READ | _WRITE, 2, FormatDescription)
G_FMT = _request(_READ | _WRITE, 4, Format)
S_FMT = _request(_READ | _WRITE, 5, Format)
REQBUFS = _request(_READ | _WRITE, 8, RequestBuffers)
QUERYBUF = _request(_READ | _WRITE, 9, Buffer)
QBUF = _request(_READ | _WRITE, 15, Buffer)
DQBUF = _request(_READ | _WRITE, 17, Buffer)
STREAMON = _request(_WRITE, 18, ctypes.c_int)
STREAMOFF = _request(_WRITE, 19, ctypes.c_int)
G_PARM = _request(_READ | _WRITE, 21, StreamParameters)
S_PARM = _request(_READ | _WRITE, 22, StreamParameters)
G_CTRL = _request(_READ | _WRITE, 27, Control)
S_CTRL = _request(_READ | _WRITE, 28, Control)
QUERYCTRL = _request(_READ | _WRITE, 36, ControlDescription)
ENUM_FRAMESIZES = _request(_READ | _WRITE, 74, FrameSize)

_NAMES = {value: name for name, value in globals().items() if name.isupper()}


def call(fd: int, request: int, argument: Any) -> Any:
    """Carry out a request; fill in the argument and return it.

    Raises
    ------
    DeviceLost
        The device is gone.
    DeviceError
        It refuses.
    """
    while True:
        try:
            fcntl.ioctl(fd, request, argument)
            return argument
        except InterruptedError:
            continue
        except OSError as error:
            if error.errno in (errno.ENODEV, errno.ENXIO, errno.EBADF):
                raise DeviceLost(
                    "The camera is gone (unplugged, or its driver was removed)."
                ) from error
            text = f"The video device refuses {_NAMES.get(request, hex(request))}: {error.strerror}"
            raise DeviceError(f"{text}.") from error
