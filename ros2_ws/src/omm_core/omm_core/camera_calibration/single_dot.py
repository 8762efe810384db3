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
# Thresholds between background and what is brightest: the dot may be dimmer than a reflection.
_LEVELS = (0.5, 0.2, 0.08)
_NOISES = 6.0  # that a threshold is above the background at least
# No ring: dark as far as the fit looks (in dot radii).
_CLEAR = 1.8
_NO_RING = np.zeros(12, dtype=np.int64)


@dataclass(frozen=True, kw_only=True, eq=False)
class SingleDot:
    """A bright dot: centre of its ellipse (col, row), covariance, mean diameter."""

    center_px: Array
    covariance_px2: Array
    diameter_px: float


def find_bright_dots(image: NDArray[Any]) -> list[SingleDot]:
    """Return the bright round things in an image (H, W), uint8 or uint16; brightest first."""
    some = image[::4, ::4].astype(np.float32)
    background = float(np.median(some))
    noise = 1.4826 * float(np.median(np.abs(some - background)))
    highest = float(np.percentile(cv2.blur(image, (5, 5)), 99.999))
    if highest - background < 0.05 * max(background, 100.0):
        return []
    saturation = float(np.iinfo(image.dtype).max)
    kept = image.view()
    kept.flags.writeable = False  # the form for which the kernels are compiled
    dots: list[SingleDot] = []
    for level in _LEVELS:
        above = level * (highest - background)
        if above < _NOISES * noise and dots:
            break
        for centre, radius in _round_things(image, background + above):
            if any(np.linalg.norm(d.center_px - centre) < d.diameter_px for d in dots):
                continue
            dot = _fitted(kept, centre, radius, saturation)
            if dot is not None:
                dots.append(dot)
    return dots


def _round_things(image: NDArray[Any], threshold: float) -> list[tuple[Array, float]]:
    """Return centre and radius of what is above a threshold and about as round as a dot."""
    bright = (image > threshold).astype(np.uint8)
    count, _, boxes, centres = cv2.connectedComponentsWithStats(bright, connectivity=8)
    width, height, area = boxes[1:count, 2:5].T.astype(float)
    longer, shorter = np.maximum(width, height), np.minimum(width, height)
    filled = area / (np.pi / 4 * width * height)
    good = (shorter >= MIN_DIAMETER_PX) & (longer <= MAX_DIAMETER_PX)
    good &= (filled > 0.6) & (filled < 1.25)
    return [(centres[1 + i], 0.5 * float(longer[i])) for i in np.flatnonzero(good)]


def _fitted(
    image: NDArray[Any], centre: Array, radius: float, saturation: float
) -> SingleDot | None:
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
    return SingleDot(
        center_px=p[:2].copy(),
        covariance_px2=fitted.covariance * max(fitted.misfit, 0.2),
        diameter_px=float(2.0 / np.prod(axes) ** 0.25),
    )
