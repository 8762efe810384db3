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

from omm_core.camera_calibration.single_dot import SingleDot, find_bright_dots
from omm_core.errors import InputError
from omm_core.files.outside import read_bytes

# What is this near in so many images, and in this part of all, does not move with the dot.
_STILL_PX, _STILL_IMAGES, _STILL_PART = 3.0, 4, 0.25


def dots_of_images(
    folder: Path, images: tuple[str, ...], shape: tuple[int, int]
) -> list[list[SingleDot]]:
    """Return the bright round things in each image.

    Raises
    ------
    InputError
        If an image is missing, damaged or of another size.
    """
    found: list[list[SingleDot]] = []
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


def without_what_stands_still(dots: list[list[SingleDot]]) -> list[list[SingleDot]]:
    """Return what is bright without what is at one place of the image whatever the dot does.

    A reflection of the camera's own light, a lamp seen in the machine: they are seen at the same
    pixel in image after image, while the dot moves from place to place.
    """
    every = [dot.center_px for of_image in dots for dot in of_image]
    if not every:
        return dots
    places = np.array(every)
    beside = np.array([len(of_image) > 1 for of_image in dots for _ in of_image])
    often = max(_STILL_IMAGES, _STILL_PART * len(dots))

    def still(dot: SingleDot) -> bool:
        near = np.linalg.norm(places - dot.center_px, axis=1) < _STILL_PX
        # Seen alone in most images, it is the dot, taken at one place again and again.
        return bool(near.sum() >= often and 2 * beside[near].sum() > near.sum())

    return [[dot for dot in of_image if not still(dot)] for of_image in dots]


def likely_dots(dots: list[list[SingleDot]], least: int) -> list[SingleDot | None]:
    """Return of each image the dot to begin with: what is seen alone, else the largest.

    Where enough images show one thing alone, the others are left for later.
    """
    if sum(len(of_image) == 1 for of_image in dots) >= least:
        return [of_image[0] if len(of_image) == 1 else None for of_image in dots]
    return [max(o, key=lambda dot: dot.diameter_px) if o else None for o in dots]


def nearest_dots(
    dots: list[list[SingleDot]], predicted: NDArray[np.float64], reach_px: float
) -> list[SingleDot | None]:
    """Return of each image the dot nearest to where it must be; None where none is near."""
    chosen: list[SingleDot | None] = []
    for candidates, place in zip(dots, predicted, strict=True):
        away = [float(np.linalg.norm(dot.center_px - place)) for dot in candidates]
        near = int(np.argmin(away)) if away else -1
        chosen.append(candidates[near] if away and away[near] < reach_px else None)
    return chosen
