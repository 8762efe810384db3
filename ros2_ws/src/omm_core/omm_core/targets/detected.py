"""What was found in an image, and what was refused."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omm_core.words import Words


@dataclass(frozen=True, kw_only=True)
class DetectedTarget:
    """A target with its number.

    Attributes
    ----------
    center_px : (2,) col, row of the centre of the dot's image; (0, 0) is the centre of the
        top-left pixel.
    covariance_px2 : (2, 2) of (col, row).
    diameter_px : mean diameter (of the circle with the ellipse's area).
    axes_px : larger and smaller diameter of the ellipse.
    angle_rad : direction of the larger axis, from col towards row.
    phase_rad : where the first bit's sector begins, clockwise in the dot's own plane.
    bright : True for a bright dot on dark.
    contrast_dn : difference of the grey values of dot and background.
    blur_px : standard deviation of the edge, the pixel's own size included.
    ring_margin : distance of the most doubtful sector from the threshold; 0.5 is perfect.
    """

    id: int
    center_px: NDArray[np.float64]
    covariance_px2: NDArray[np.float64]
    diameter_px: float
    axes_px: tuple[float, float]
    angle_rad: float
    phase_rad: float
    bright: bool
    contrast_dn: float
    blur_px: float
    ring_margin: float


@dataclass(frozen=True, kw_only=True)
class RefusedTarget:
    """Something that looked like a target and was not accepted."""

    center_px: NDArray[np.float64]
    diameter_px: float
    reason: Words


@dataclass(frozen=True, kw_only=True)
class Detection:
    """What was found in one image, in order of number; and what was refused."""

    targets: tuple[DetectedTarget, ...] = field(default=())
    refused: tuple[RefusedTarget, ...] = field(default=())
