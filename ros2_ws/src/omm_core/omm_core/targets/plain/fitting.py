"""The centre of a plain dot, by the model of the coded targets' dots, with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.targets.conic.dot_equations import SlopesPrior
from omm_core.targets.conic.dot_fit import fit_dot, start_at
from omm_core.targets.conic.dot_model import BLUR, XX, XY, YY, Noise, Ring
from omm_core.targets.conic.outline import (
    LEVEL_IN,
    LEVEL_OUT,
    WIDTH,
    semi_axes,
    square_root,
)

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
    blur = max(float(shape[WIDTH]), 0.35)
    smaller = semi_axes(shape[XX], shape[XY], shape[YY])[0]
    # The window: as far as the edge's blur reaches, where nothing else lies there.
    for reach in (max(1.5, 1.0 + 3.2 * blur / smaller), 1.5):
        dot = _fitted(image, shape, sign, 1.0 + (reach - 1.0) / 0.6, saturation)
        if dot is not None:
            return dot
    return None


def _fitted(
    image: NDArray[Any], shape: Array, sign: int, inner: float, saturation: float
) -> PlainDot | None:
    contrast = abs(float(shape[LEVEL_IN] - shape[LEVEL_OUT]))
    light, ground = (_LIGHT, _GROUND) if sign > 0 else (_GROUND, _LIGHT)
    prior = np.diag(np.repeat([1 / (light * contrast) ** 2, 1 / (ground * contrast) ** 2], 2))
    slopes, ring = SlopesPrior(prior, np.zeros(4)), Ring(inner, _NO_RING, 0.0)
    # About what 8 bit have, in the image's own grey values.
    read, gain = max((contrast / 255.0) ** 2, 1.0), 0.0
    # The second time with the noise that the first fit shows on the dot and beside it.
    for _ in range(2):
        fitted = start_at(shape)
        noise = Noise(read, gain, saturation)
        if not fit_dot(image, shape, sign, ring, noise, slopes, fitted):
            return None
        read, gain = fitted.noise(_READ_DN**2)
    p = fitted.p
    if fitted.residual > MAX_RESIDUAL * abs(fitted.contrast):
        return None
    if np.hypot(*(p[:2] - shape[:2])) > 1.0:
        return None
    a11, a12, a22 = square_root(p[XX], p[XY], p[YY])
    root = np.array([[a11, a12], [a12, a22]])
    return PlainDot(
        center_px=p[:2].copy(),
        covariance_px2=fitted.covariance * max(fitted.misfit, 0.2),
        diameter_px=2.0 * math.sqrt(np.linalg.det(root)),
        spread_px2=root @ root,
        contrast_dn=abs(fitted.contrast),
        blur_px=float(p[BLUR]),
    )
