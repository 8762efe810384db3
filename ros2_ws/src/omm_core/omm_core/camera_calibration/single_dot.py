"""Find the plain bright dot of a CMM set in an image, by the same model as coded targets' dots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omm_core.targets.conic.dot_equations import SlopesPrior
from omm_core.targets.conic.dot_fit import fit_dot, start_at
from omm_core.targets.conic.dot_model import XX, XY, YY, Noise, Ring
from omm_core.targets.conic.outline import dot_outline

Array = NDArray[np.float64]

MIN_DIAMETER_PX, MAX_DIAMETER_PX = 8, 160
# No ring: dark as far as the fit looks (in dot radii).
_CLEAR = 1.8
_NO_RING = np.zeros(12, dtype=np.int64)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlainDot:
    """A bright dot: centre of its ellipse (col, row), covariance, mean diameter."""

    center_px: Array
    covariance_px2: Array
    diameter_px: float


def find_bright_dots(image: NDArray[Any]) -> list[PlainDot]:
    """Return the bright round things in an image (H, W), uint8 or uint16; brightest first."""
    background = float(np.median(image[::4, ::4]))
    highest = float(np.percentile(cv2.blur(image, (5, 5)), 99.999))
    if highest - background < 0.05 * max(background, 100.0):
        return []
    bright = (image > 0.5 * (background + highest)).astype(np.uint8)
    count, _, boxes, centres = cv2.connectedComponentsWithStats(bright, connectivity=8)
    saturation = float(np.iinfo(image.dtype).max)
    kept = image.view()
    kept.flags.writeable = False  # the form for which the kernels are compiled
    dots = []
    for label in range(1, count):
        width, height, area = boxes[label, 2:5]
        longer, shorter = max(width, height), min(width, height)
        filled = area / (np.pi / 4 * width * height)
        if shorter >= MIN_DIAMETER_PX and longer <= MAX_DIAMETER_PX and 0.6 < filled < 1.25:
            dot = _fitted(kept, centres[label], 0.5 * float(longer), saturation)
            if dot is not None:
                dots.append(dot)
    return dots


def _fitted(
    image: NDArray[Any], centre: Array, radius: float, saturation: float
) -> PlainDot | None:
    round_px2 = 1.0 / radius**2
    shape, ok = dot_outline(image, np.array([*centre, round_px2, 0.0, round_px2, 1.0]))
    if not ok:
        return None
    fitted = start_at(shape)
    ring, light = Ring(_CLEAR, _NO_RING, 0.0), SlopesPrior(np.zeros((4, 4)), np.zeros(4))
    read, gain = 1.0, 0.0
    # The second time with the noise that the first fit shows on the dot and beside it.
    for _ in range(2):
        if not fit_dot(image, shape, 1, ring, Noise(read, gain, saturation), light, fitted):
            return None
        read, gain = fitted.noise(0.08)  # at least what rounding makes
    p = fitted.p
    axes = np.linalg.eigvalsh(np.array([[p[XX], p[XY]], [p[XY], p[YY]]]))
    return PlainDot(
        center_px=p[:2].copy(),
        covariance_px2=fitted.covariance * max(fitted.misfit, 0.2),
        diameter_px=float(2.0 / np.prod(axes) ** 0.25),
    )
