"""The centre of a plain dot, by the model of the coded targets' dots, with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.targets.conic.dot_fit import fit_dot
from omm_core.targets.conic.dot_model import PARAMETERS
from omm_core.targets.conic.outline import semi_axes, square_root

Array = NDArray[np.float64]

_NO_RING = np.zeros(12, dtype=np.int64)
_LIGHT, _GROUND = 0.004, 0.03
"""How much the light on a dot, and the ground around it, may fall per dot radius (standard
deviation, of the contrast): no ring tells, and left free it costs up to 40 % of the accuracy."""
MAX_MISFIT, MAX_RESIDUAL = 4.0, 0.06
_READ_DN = 0.3  # least noise, of rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class PlainDot:
    """A plain dot.

    Attributes
    ----------
    center_px : (2,) col, row of the centre of its ellipse.
    covariance_px2 : (2, 2)
    diameter_px : of the circle with the ellipse's area.
    spread_px2 : (2, 2) matrix S of the ellipse dᵀ S⁻¹ d = 1.
    contrast_dn, blur_px : as of `DetectedTarget`.
    """

    center_px: Array
    covariance_px2: Array
    diameter_px: float
    spread_px2: Array
    contrast_dn: float
    blur_px: float


def fitted_dot(image: NDArray[Any], shape: Array, sign: int, saturation: float) -> PlainDot | None:
    """Return the dot whose outline (9,) is given, or None where it is not one evenly lit dot."""
    blur = max(float(shape[8]), 0.35)
    smaller = semi_axes(shape[2], shape[3], shape[4])[0]
    # The window: as far as the edge's blur reaches, where nothing else lies there.
    for reach in (max(1.5, 1.0 + 3.2 * blur / smaller), 1.5):
        dot = _fitted(image, shape, sign, 1.0 + (reach - 1.0) / 0.6, saturation)
        if dot is not None:
            return dot
    return None


def _fitted(
    image: NDArray[Any], shape: Array, sign: int, inner: float, saturation: float
) -> PlainDot | None:
    p = np.zeros(PARAMETERS)
    contrast = abs(float(shape[5] - shape[6]))
    light, ground = (_LIGHT, _GROUND) if sign > 0 else (_GROUND, _LIGHT)
    prior = np.diag(np.repeat([1 / (light * contrast) ** 2, 1 / (ground * contrast) ** 2], 2))
    covariance, statistics = np.zeros((2, 2)), np.zeros(6)
    read, gain = 1.0, 0.0
    # The second time with the noise that the first fit shows on the dot and beside it.
    for _ in range(2):
        p[:] = 0.0
        p[:5], p[5], p[6], p[9] = shape[:5], max(float(shape[8]), 0.35), shape[5], shape[6]
        ok = fit_dot(
            image, shape, sign, inner, _NO_RING, 0.0, read, gain, saturation, prior, np.zeros(4),
            p, covariance, statistics,
        )  # fmt: skip
        if not ok:
            return None
        on_dot = statistics[1] / max(statistics[0], 1.0)
        beside = statistics[3] / max(statistics[2], 1.0)
        gain = max(on_dot - beside, 0.0) / max(float(p[6] - p[9]), 1.0)
        read = max(beside - gain * max(float(p[9]), 0.0), _READ_DN**2)
    free = max(float(statistics[5]) - PARAMETERS, 1.0)
    residual = math.sqrt((statistics[1] + statistics[3]) / (free + PARAMETERS))
    misfit = float(statistics[4]) / free
    if residual > MAX_RESIDUAL * abs(p[6] - p[9]) or np.hypot(*(p[:2] - shape[:2])) > 1.0:
        return None
    a11, a12, a22 = square_root(p[2], p[3], p[4])
    root = np.array([[a11, a12], [a12, a22]])
    return PlainDot(
        center_px=p[:2].copy(),
        covariance_px2=covariance * max(misfit, 0.2),
        diameter_px=2.0 * math.sqrt(np.linalg.det(root)),
        spread_px2=root @ root,
        contrast_dn=abs(float(p[6] - p[9])),
        blur_px=float(p[5]),
    )
