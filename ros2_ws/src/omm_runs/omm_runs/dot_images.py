"""The dot of a CMM set in all of its images, side by side, and which bright thing it is."""

from __future__ import annotations

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omm_core.camera_calibration.single_dot import PlainDot, find_bright_dots
from omm_core.errors import InputError
from omm_core.files.outside import read_bytes


def dots_of_images(
    folder: Path, images: tuple[str, ...], shape: tuple[int, int]
) -> list[list[PlainDot]]:
    """Return the bright round things in each image.

    Raises
    ------
    InputError
        If an image is missing, damaged or of another size.
    """
    found: list[list[PlainDot]] = []
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for dots in pool.map(lambda name: find_bright_dots(_read(folder / name, shape)), images):
            found.append(dots)
            if sys.stderr.isatty():
                print(f"\rimages: {len(found)} of {len(images)}", end="", file=sys.stderr)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    return found


def _read(path: Path, shape: tuple[int, int]) -> NDArray[Any]:
    data = read_bytes(path, "image", 1 << 30)
    cut = data.startswith(b"\x89PNG") and b"IEND" not in data[-4096:]
    flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    image = None if cut or not data else cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: expected an image of 8 or 16 bit, got a damaged or other file.")
    if image.shape[:2] != shape:
        raise InputError(
            f"{path}: expected {shape[1]} x {shape[0]} pixels, as the set says, got"
            f" {image.shape[1]} x {image.shape[0]}."
        )
    return np.ascontiguousarray(image)


def nearest_dots(
    dots: list[list[PlainDot]], predicted: NDArray[np.float64], reach_px: float
) -> list[PlainDot | None]:
    """Return of each image the dot nearest to where it must be; None where none is near."""
    chosen: list[PlainDot | None] = []
    for candidates, place in zip(dots, predicted, strict=True):
        away = [float(np.linalg.norm(dot.center_px - place)) for dot in candidates]
        near = int(np.argmin(away)) if away else -1
        chosen.append(candidates[near] if away and away[near] < reach_px else None)
    return chosen
