"""Numbers and image sizes as the calibration files of other programs write them."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError

Matrix = NDArray[np.float64]
_FAR_OFF = 0.15
_SIZES = ("image_size", "imageSize", "img_size", "ImageSize", "resolution")
_WIDTHS = ("image_width", "image_Width", "width", "img_width", "imageWidth", "Camera.width")
_HEIGHTS = ("image_height", "image_Height", "height", "img_height", "imageHeight", "Camera.height")


def number(value: Any) -> float:
    """Return a number; OpenCV's ``.Nan`` and ``-.Inf`` are numbers that the lens then refuses.

    Raises
    ------
    InputError
        Where it is none; a decimal comma is called by its name.
    """
    if isinstance(value, str):
        text = value.strip()
        if re.fullmatch(r"[-+]?\.(nan|inf)", text, re.IGNORECASE):
            text = text.replace(".", "")
        if re.fullmatch(r"[-+]?\d+,\d+([eE][-+]?\d+)?", text):
            raise InputError(
                f"expected a decimal point, got {text}: write {text.replace(',', '.')}."
            )
        try:
            return float(text)
        except ValueError:
            raise InputError(f"expected a number, got {text[:80]!r}.") from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"expected a number, got {str(value)[:80]!r}.")
    return float(value)


def numbers(values: Any) -> list[float]:
    """Return all numbers of a matrix, however it is nested: OpenCV's ``data``, lists in lists."""
    if isinstance(values, dict):
        if "data" not in values:
            raise InputError(f"expected a matrix with its 'data', got {str(values)[:80]}.")
        values = values["data"]
    if isinstance(values, str):
        values = values.split()
    return [number(v) for v in np.ravel(np.array(values, dtype=object))]


def matrix(values: Any) -> Matrix:
    """Return a camera matrix, (3, 3)."""
    data = numbers(values)
    if len(data) != 9:
        raise InputError(
            f"expected 9 numbers in the camera matrix, got {len(data)}"
            + (" (decimal commas?)." if len(data) > 9 else ".")
        )
    return np.reshape(data, (3, 3))


def image_size(values: dict[str, Any]) -> tuple[int, int]:
    """Return the image's width and height, by whichever name they are there.

    Raises
    ------
    InputError
        Where the file does not tell them, or tells no whole numbers.
    """
    width = next((values[name] for name in _WIDTHS if name in values), None)
    height = next((values[name] for name in _HEIGHTS if name in values), None)
    if width is None or height is None:
        size = next((values[name] for name in _SIZES if name in values), None)
        if isinstance(size, dict) and "data" not in size:
            return image_size(size)
        if size is None:
            raise InputError(
                "the image's size is not in it. Add it to the file as 'image_width: 1920' and"
                " 'image_height: 1080', with the numbers of the images it was made from."
            )
        pair = numbers(size)
        if len(pair) != 2:
            raise InputError(f"expected the image's width and height, got {len(pair)} numbers.")
        width, height = pair
    found = number(width), number(height)
    if not all(v.is_integer() for v in found):
        raise InputError(f"expected the image's size in whole pixels, got {width} x {height}.")
    return int(found[0]), int(found[1])


def off_middle(camera: Matrix, size: tuple[int, int]) -> tuple[str, ...]:
    """Return a finding where the principal point is not where that of a real image is.

    Raises
    ------
    InputError
        Where it is outside the image: then the size or the matrix is another camera's.
    """
    at = camera[:2, 2]
    if not all(-0.5 <= a <= s - 0.5 for a, s in zip(at, size)):
        raise InputError(
            f"expected a principal point inside the image of {size[0]} x {size[1]} pixels, got"
            f" {at[0]:g}, {at[1]:g}. Is the size that of the images it was made from, width first?"
        )
    off = [abs(a - (s - 1) / 2) / s for a, s in zip(at, size)]
    if max(off) <= _FAR_OFF:
        return ()
    return (
        f"the principal point {at[0]:g}, {at[1]:g} is {100 * max(off):.0f} % of the image off its"
        f" middle; check that {size[0]} x {size[1]} is the size of the images, width first",
    )
