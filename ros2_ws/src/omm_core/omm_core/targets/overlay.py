"""Drawing of what was found, for a person to look at."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omm_core.targets.coded.detection import DetectedTarget, Detection

GREEN, RED, YELLOW = (60, 200, 60), (60, 60, 255), (0, 220, 255)
_SHIFT = 4


def draw_detection(image: NDArray[Any], detection: Detection) -> NDArray[np.uint8]:
    """Draw ellipses, centres and numbers (green) and what was refused (red) over an image.

    Parameters
    ----------
    image : (H, W) uint8 or uint16.

    Returns
    -------
    (H, W, 3) BGR.
    """
    if image.dtype != np.uint8:
        image = np.asarray(image / max(float(image.max()), 1.0) * 255.0, dtype=np.uint8)
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    for target in detection.targets:
        _draw_target(picture, target)
    for refused in detection.refused:
        radius = max(refused.diameter_px, 8.0)
        cv2.circle(
            picture,
            _fixed(refused.center_px),
            round(radius * 2**_SHIFT),
            RED,
            1,
            cv2.LINE_AA,
            _SHIFT,
        )
        _write(picture, refused.center_px, radius, refused.reason.split(":")[0], RED, 0.35)
    return np.asarray(picture, dtype=np.uint8)


def _draw_target(picture: NDArray[Any], target: DetectedTarget) -> None:
    axes = tuple(round(0.5 * axis * 2**_SHIFT) for axis in target.axes_px)
    cv2.ellipse(
        picture,
        _fixed(target.center_px),
        axes,
        math.degrees(target.angle_rad),
        0.0,
        360.0,
        GREEN,
        1,
        cv2.LINE_AA,
        _SHIFT,
    )
    arm = max(0.15 * target.diameter_px, 2.0)
    for step in ((arm, 0.0), (0.0, arm)):
        offset = np.array(step)
        cv2.line(
            picture,
            _fixed(target.center_px - offset),
            _fixed(target.center_px + offset),
            YELLOW,
            1,
            cv2.LINE_AA,
            _SHIFT,
        )
    size = min(max(target.diameter_px / 25.0, 0.45), 3.0)
    _write(picture, target.center_px, 1.8 * target.diameter_px, str(target.id), YELLOW, size)


def _fixed(point: NDArray[np.float64]) -> tuple[int, int]:
    """Return OpenCV's fixed-point coordinates: pixels' centres are whole numbers, as here."""
    return round(float(point[0]) * 2**_SHIFT), round(float(point[1]) * 2**_SHIFT)


def _write(
    picture: NDArray[Any], at: NDArray[Any], below: float, text: str, colour: Any, size: float
) -> None:
    place = (round(float(at[0]) - 5.0 * size * len(text)), round(float(at[1]) + below))
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
