"""Photographs as they are stored: grey pixels, no orientation applied, whole or refused.

Whether a JPEG is whole is decided by decoding. Its end is found by walking its segments, so bytes
behind it (motion photographs, padding) do no harm. OpenCV fills what is missing with grey and says
nothing; so the scan is decoded a second time with noise in front of the end marker: a whole image
never reads it, one that is cut short does, and its pixels change (ITU-T T.81, B.1 and F.2.2). Cuts
at restart markers and between scans are seen by what the headers promise (`jpeg_scans`).
"""

from __future__ import annotations

import glob
import io
import warnings
import zlib
from pathlib import Path
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.outside import read_bytes
from omm_core.imaging.jpeg_scans import scans_of

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm")
Pixels = NDArray[np.uint8] | NDArray[np.uint16]
_FLAGS = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
_LOGGING = getattr(cv2.utils, "logging", cv2)  # OpenCV 4.6 (Ubuntu 24.04) has it in cv2
_ONLY_ERRORS = 2
_NOISE = np.random.default_rng(1).integers(1, 255, 4096, dtype=np.uint8).tobytes()


def find_images(names: list[str]) -> list[Path]:
    """Resolve files, folders and patterns, in order and each once.

    Raises
    ------
    InputError
        If a name leads to nothing.
    """
    found: list[Path] = []
    for name in names:
        path = Path(name)
        if path.is_dir():
            inside = [p for p in sorted(path.iterdir()) if p.suffix.lower() in SUFFIXES]
            if not inside:
                raise InputError(f"{name}: no images in this folder ({', '.join(SUFFIXES)}).")
            found += inside
        elif path.is_file():
            found.append(path)
        else:
            matches = [
                Path(m) for m in sorted(glob.glob(name, recursive=True)) if Path(m).is_file()
            ]
            if not matches:
                raise InputError(
                    f"{name}: expected an image, a folder or a pattern, found nothing."
                )
            found += matches
    return list(dict.fromkeys(found))


def read_grey(path: Path) -> Pixels:
    """Read an image as (H, W) uint8 or uint16, as stored.

    Raises
    ------
    InputError
        If it is not an image, or damaged.
    """
    return _decoded(path, _read(path))


_LARGEST_BYTES = 1 << 30


def _read(path: Path) -> bytes:
    return read_bytes(path, "photograph", _LARGEST_BYTES)


def _decoded(path: Path, data: bytes) -> Pixels:
    if data.startswith(b"\x89PNG"):
        _refuse_cut_png(path, data)
    end = _end_of_jpeg(path, data) if data.startswith(b"\xff\xd8") else len(data)
    image = _decode(data[:end])
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: not an image of 8 or 16 bit, or damaged; skipped.")
    if data.startswith(b"\xff\xd8"):
        scans = scans_of(data[:end])
        if scans.trouble:
            raise InputError(f"{path}: the file is cut off or damaged ({scans.trouble}); skipped.")
        longer = scans.with_noise(data[: end - 2], _NOISE) + _NOISE + b"\xff\xd9"
        if not np.array_equal(_quietly(path, data[:end]), _quietly(path, longer)):
            raise InputError(f"{path}: the file is cut off; skipped.")
    return cast("Pixels", np.ascontiguousarray(image.reshape(image.shape[:2])))


def _decode(data: bytes) -> Pixels | None:
    # OpenCV prints what it thinks of every tag that it does not know.
    level = _LOGGING.setLogLevel(_ONLY_ERRORS)
    try:
        image: Pixels | None = cv2.imdecode(np.frombuffer(data, np.uint8), _FLAGS) if data else None
    except cv2.error:
        return None
    finally:
        _LOGGING.setLogLevel(level)
    return image


def _quietly(path: Path, data: bytes) -> NDArray[np.uint8]:
    """Decode with Pillow, which does not print what the JPEG library says of the noise."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data)) as image:
                return np.asarray(image)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: cannot be decoded: {error}; skipped.") from error


def _end_of_jpeg(path: Path, data: bytes) -> int:
    """Return where the first image ends, behind its end marker."""
    at, size = 2, len(data)
    while at + 2 <= size:
        at = data.find(b"\xff", at)
        if at < 0 or at + 2 > size:
            break
        marker = data[at + 1]
        if marker == 0xD9:
            return at + 2
        if marker == 0xFF:  # a byte of filling
            at += 1
        elif marker in (0x00, 0x01) or 0xD0 <= marker <= 0xD8:  # without a length
            at += 2
        else:
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    raise InputError(f"{path}: the file is cut off; skipped.")


def _refuse_cut_png(path: Path, data: bytes) -> None:
    at = 8
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        kind, end = data[at + 4 : at + 8], at + 8 + length
        if int.from_bytes(data[end : end + 4], "big") != zlib.crc32(data[at + 4 : end]):
            break
        if kind == b"IEND":
            return
        at = end + 4
    raise InputError(f"{path}: the file is cut off or damaged; skipped.")
