"""Raw pixel data of cameras as monochrome images; colours by the rule of `imaging.encodings`.

Values of more than 8 bits are shifted up to fill 16 bits, as mono16 is understood everywhere.
"""

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import DeviceError
from omm_core.imaging.encodings import grey_image

# GenICam PFNC: pixel format numbers.
MONO8 = 0x01080001
MONO10, MONO12, MONO14, MONO16 = 0x01100003, 0x01100005, 0x01100025, 0x01100007
MONO10_PACKED, MONO12_PACKED = 0x010C0004, 0x010C0006  # GigE Vision: 2 pixels in 3 bytes
MONO10P, MONO12P = 0x010A0046, 0x010C0047  # PFNC: a stream of bits, lowest first

# Colours: ROS's name of the encoding, and by how many bits it is shifted up.
_COLOURS = {
    0x02180014: ("rgb8", 0),
    0x02180015: ("bgr8", 0),
    0x01080008: ("bayer_grbg8", 0),
    0x01080009: ("bayer_rggb8", 0),
    0x0108000A: ("bayer_gbrg8", 0),
    0x0108000B: ("bayer_bggr8", 0),
    **{
        first + k: (f"bayer_{pattern}16", shift)
        for first, shift in ((0x0110000C, 6), (0x01100010, 4), (0x0110002E, 0))
        for k, pattern in enumerate(("grbg", "rggb", "gbrg", "bggr"))
    },
}

# The packed formats are read in groups of whole pixels and whole bytes.
_GROUP_BITS = {MONO10_PACKED: 24, MONO12_PACKED: 24, MONO10P: 40, MONO12P: 24}

_STRIDE, _DARK = 4, 0.03

_UNPACKED_SHIFT = {MONO10: 6, MONO12: 4, MONO14: 2, MONO16: 0}


def bytes_of(pixel_format: int, width: int, height: int) -> int:
    """Return an image's size in bytes (PFNC tells the bits of a pixel in its number)."""
    return width * height * (pixel_format >> 16 & 0xFF) // 8


def is_read(pixel_format: int) -> bool:
    """Return whether images of this format are read."""
    return pixel_format in {
        MONO8, *_UNPACKED_SHIFT, MONO10_PACKED, MONO12_PACKED, MONO10P, MONO12P, *_COLOURS
    }  # fmt: skip


def mono_from_genicam(
    data: NDArray[np.uint8], pixel_format: int, width: int, height: int, *, row_padding: int = 0
) -> NDArray[np.generic]:
    """Return the image (height, width) uint8 or uint16; a view of Mono8 and Mono16 data.

    Parameters
    ----------
    row_padding : bytes after each row that are no pixels

    Raises
    ------
    DeviceError
        The format is not read, or the data are too short, or do not end with a row's end.
    """
    size = bytes_of(pixel_format, width, height)
    row_bits = width * (pixel_format >> 16 & 0xFF)
    if row_padding and row_bits % 8 == 0:
        data = _without_padding(data, row_bits // 8, row_padding, height)
    elif row_padding or row_bits * height % _GROUP_BITS.get(pixel_format, 8):
        raise DeviceError(
            f"Expected a width whose rows fill whole bytes, got {width} pixels of format "
            f"0x{pixel_format:08x}. Set roi_width_px to a multiple of 4."
        )
    if len(data) < size:
        raise DeviceError(f"Expected {size} bytes for {width} × {height} pixels, got {len(data)}.")
    data = data[:size]
    if pixel_format == MONO8:
        return data.reshape(height, width)
    if pixel_format in _UNPACKED_SHIFT:
        pixels = data.view("<u2").reshape(height, width)
        shift = _UNPACKED_SHIFT[pixel_format]
        return pixels << shift if shift else pixels
    if pixel_format in (MONO10_PACKED, MONO12_PACKED):
        return _unpack_gige(data, pixel_format == MONO12_PACKED).reshape(height, width)
    if pixel_format == MONO12P:
        return _unpack_12p(data).reshape(height, width)
    if pixel_format == MONO10P:
        return _unpack_10p(data).reshape(height, width)
    if pixel_format in _COLOURS:
        return _grey(data, *_COLOURS[pixel_format], width, height)
    raise DeviceError(
        "Expected a pixel format of Mono8, 10, 12 or 16 (packed or not), Bayer8 to 16, RGB8 or "
        f"BGR8, got 0x{pixel_format:08x}. Set the parameter pixel_format."
    )


def _without_padding(
    data: NDArray[np.uint8], row_bytes: int, padding: int, height: int
) -> NDArray[np.uint8]:
    step = row_bytes + padding
    # The last row's padding may be left out.
    whole = np.resize(data[: step * height], step * height) if height else data[:0]
    if len(data) < step * height - padding:
        raise DeviceError(f"Expected {step * height} bytes in {height} rows, got {len(data)}.")
    return np.ascontiguousarray(whole.reshape(height, step)[:, :row_bytes]).reshape(-1)


def _grey(
    data: NDArray[np.uint8], encoding: str, shift: int, width: int, height: int
) -> NDArray[np.generic]:
    if shift:
        data = (data.view("<u2") << shift).view(np.uint8)
    return grey_image(
        data,
        encoding,
        height_px=height,
        width_px=width,
        step_bytes=len(data) // height,
        big_endian=False,
    )


def _unpack_gige(data: NDArray[np.uint8], twelve: bool) -> NDArray[np.uint16]:
    """Unpack pairs of pixels, (height, width), from three bytes each.

    The bytes: high bits of pixel 0, low bits of both (0 in the lower half), high bits of pixel 1.
    """
    triples = data.reshape(-1, 3).astype(np.uint16)
    low = 4 if twelve else 2
    mask = (1 << low) - 1
    out = np.empty((len(triples), 2), np.uint16)
    out[:, 0] = triples[:, 0] << low | triples[:, 1] & mask
    out[:, 1] = triples[:, 2] << low | triples[:, 1] >> 4 & mask
    return (out << (8 - low)).reshape(-1).astype(np.uint16, copy=False)


def _unpack_12p(data: NDArray[np.uint8]) -> NDArray[np.uint16]:
    triples = data.reshape(-1, 3).astype(np.uint16)
    out = np.empty((len(triples), 2), np.uint16)
    out[:, 0] = triples[:, 0] | (triples[:, 1] & 0x0F) << 8
    out[:, 1] = triples[:, 1] >> 4 | triples[:, 2] << 4
    return (out << 4).reshape(-1).astype(np.uint16, copy=False)


def _unpack_10p(data: NDArray[np.uint8]) -> NDArray[np.uint16]:
    fives = data.reshape(-1, 5).astype(np.uint16)
    out = np.empty((len(fives), 4), np.uint16)
    for i in range(4):
        out[:, i] = (fives[:, i] >> 2 * i | fives[:, i + 1] << 8 - 2 * i) & 0x3FF
    return (out << 6).reshape(-1).astype(np.uint16, copy=False)


def mono_from_yuyv(
    data: NDArray[np.uint8], width: int, height: int, row_bytes: int
) -> NDArray[np.uint8]:
    """Return the brightness of a YUYV image, (height, width); a copy."""
    rows = data[: row_bytes * height].reshape(height, row_bytes)
    return rows[:, : 2 * width : 2].copy()


def without_contrast(image: NDArray[np.generic]) -> str:
    """Return what is to be said of an image on which nothing can be seen; mostly nothing.

    Every fourth pixel of every fourth row tells: a target's dot is larger than that.
    """
    seen = image[::_STRIDE, ::_STRIDE]
    if not seen.size:
        return ""
    full = float(2 ** (8 * image.itemsize) - 1)
    low, high = float(seen.min()) / full, float(seen.max()) / full
    if high < _DARK:
        return (
            f"The last image is black (no pixel above {100 * high:.0f} % of full scale). Is the "
            "lens cap off, the light on, the exposure time long enough?"
        )
    if low > 1.0 - _DARK:
        return (
            "The last image is white (every pixel at full scale). Shorten the exposure time, or "
            "lower the gain."
        )
    return ""
