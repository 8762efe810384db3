"""Images as cameras and recordings encode them, made grey by one rule for all of omm.

The rule: monochrome pixels stay as they are; of Y'CbCr the Y' is taken; of colours the luma of
ITU-R BT.601 (0.299 R + 0.587 G + 0.114 B, rounded), as OpenCV computes it, alpha ignored; a Bayer
mosaic is interpolated bilinearly to the same luma. All of these are symmetric about a pixel's
centre: they do not move a dot. Names are those of ROS (sensor_msgs/image_encodings).
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.words import keyed, verbatim

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, kw_only=True)
class _Encoding:
    """How many values of which size a pixel has, and how they become grey."""

    channels: int = 1
    bits: int = 8
    conversion: int | None = None
    luma: int | None = None
    """Where Y' stands among the values, where it is there already."""


# OpenCV names a mosaic by its second row's second and third pixel, ROS by the first two rows.
_MOSAICS = {
    "bayer_rggb": cv2.COLOR_BayerBG2GRAY,
    "bayer_bggr": cv2.COLOR_BayerRG2GRAY,
    "bayer_gbrg": cv2.COLOR_BayerGR2GRAY,
    "bayer_grbg": cv2.COLOR_BayerGB2GRAY,
}
_COLOURS = {
    "bgr": (3, cv2.COLOR_BGR2GRAY),
    "rgb": (3, cv2.COLOR_RGB2GRAY),
    "bgra": (4, cv2.COLOR_BGRA2GRAY),
    "rgba": (4, cv2.COLOR_RGBA2GRAY),
}
_ENCODINGS: dict[str, _Encoding] = {
    "mono8": _Encoding(),
    "8UC1": _Encoding(),
    "mono16": _Encoding(bits=16),
    "16UC1": _Encoding(bits=16),
    "8UC3": _Encoding(channels=3, conversion=cv2.COLOR_BGR2GRAY),
    "8UC4": _Encoding(channels=4, conversion=cv2.COLOR_BGRA2GRAY),
    "yuv422_yuy2": _Encoding(channels=2, luma=0),
    "yuyv": _Encoding(channels=2, luma=0),
    "yuv422": _Encoding(channels=2, luma=1),
    "uyvy": _Encoding(channels=2, luma=1),
}
for _name, (_channels, _conversion) in _COLOURS.items():
    for _bits in (8, 16):
        _ENCODINGS[f"{_name}{_bits}"] = _Encoding(
            channels=_channels, bits=_bits, conversion=_conversion
        )
for _name, _conversion in _MOSAICS.items():
    for _bits in (8, 16):
        _ENCODINGS[f"{_name}{_bits}"] = _Encoding(bits=_bits, conversion=_conversion)

KNOWN_ENCODINGS = tuple(_ENCODINGS)
_BY_LOWER_CASE = {name.lower(): kind for name, kind in _ENCODINGS.items()}


def liberties(encoding: str, step_bytes: int) -> str:
    """Return what of an image is not as ROS writes it and is read all the same; else nothing."""
    told = []
    if encoding not in _ENCODINGS and encoding.lower() in _BY_LOWER_CASE:
        told.append(f"the encoding {encoding!r} is read as ROS's of that name")
    if step_bytes == 0:
        told.append("a step of 0 is read as rows without padding")
    return f"images: {'; '.join(told)}. Their driver should say it as ROS does." if told else ""


def grey_image(
    data: Any, encoding: str, *, height_px: int, width_px: int, step_bytes: int, big_endian: bool
) -> Pixels:
    """Make an encoded image grey.

    Parameters
    ----------
    data : bytes of the rows, one after the other
    encoding : as ROS names it, in capitals or not: ``mono8``, ``bgr8``, ``bayer_rggb8``, …
    height_px, width_px, step_bytes : rows, pixels of a row, bytes of a row with its padding (0:
        without, where the data fill the image exactly)
    big_endian : order of the bytes of 16-bit values

    Returns
    -------
    (height, width) uint8 or uint16; of monochrome images without a copy, where the rows allow it

    Raises
    ------
    InputError
        The encoding is none of `KNOWN_ENCODINGS`, or the data do not fill the image.
    """
    kind = _BY_LOWER_CASE.get(encoding.lower())
    if kind is None:
        raise InputError(
            keyed(
                "said.encoding",
                "Expected images encoded as mono8, mono16, bgr8, rgb8, bgra8, rgba8, 8UC3,"
                " yuv422_yuy2 or bayer_*, got {got}. Set the camera to a monochrome format.",
                got=verbatim(repr(encoding or "no encoding")),
            )
        )
    dtype = np.dtype("u1" if kind.bits == 8 else ">u2" if big_endian else "<u2")
    row_bytes = width_px * kind.channels * dtype.itemsize
    values = np.frombuffer(data, dtype=np.uint8) if not isinstance(data, np.ndarray) else data
    values = values.reshape(-1)
    step_bytes = step_bytes or (row_bytes if values.size == row_bytes * height_px else 0)
    short = step_bytes < row_bytes or values.size < step_bytes * height_px
    if width_px <= 0 or height_px <= 0 or short:
        raise InputError(
            keyed(
                "said.image_damaged",
                "Expected {rows} rows of {bytes} bytes, got {got} bytes in rows of {step}: the"
                " image is damaged.",
                rows=height_px, bytes=row_bytes, got=values.size, step=step_bytes,
            )
        )  # fmt: skip
    rows = values[: step_bytes * height_px].reshape(height_px, step_bytes)[:, :row_bytes]
    if not rows.flags.c_contiguous and dtype.itemsize > 1:
        rows = np.ascontiguousarray(rows)
    pixels = rows.view(dtype)
    if not dtype.isnative:
        pixels = pixels.astype(dtype.newbyteorder("="))
    if kind.channels > 1:
        pixels = pixels.reshape(height_px, width_px, kind.channels)
    if kind.luma is not None:
        return np.ascontiguousarray(pixels[:, :, kind.luma])
    if kind.conversion is None:
        return pixels
    return cv2.cvtColor(np.ascontiguousarray(pixels), kind.conversion)
