"""Brown's polynomial, and the inverse of such functions by Newton's method."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


_NEWTON_STEPS = 30
_NEWTON_TOLERANCE = 1e-14  # relative to the size of the image


def brown_polynomial(
    xy: Array, radial: tuple[float, float, float], *, along_x: float, along_y: float
) -> tuple[Array, Array]:
    """Return Brown's polynomial and its derivative, (N, 2) -> (N, 2), (N, 2, 2).

    ``along_x`` multiplies ``(r² + 2x², 2xy)``, ``along_y`` multiplies ``(2xy, r² + 2y²)``.
    """
    x, y = xy[:, 0], xy[:, 1]
    k1, k2, k3 = radial
    r2 = x * x + y * y
    scale = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # d(scale)/dx = slope x
    value = np.empty_like(xy)
    value[:, 0] = x * scale + along_x * (r2 + 2 * x * x) + 2 * along_y * x * y
    value[:, 1] = y * scale + along_y * (r2 + 2 * y * y) + 2 * along_x * x * y
    jacobian = np.empty((len(xy), 2, 2))
    jacobian[:, 0, 0] = scale + slope * x * x + 6 * along_x * x + 2 * along_y * y
    jacobian[:, 1, 1] = scale + slope * y * y + 6 * along_y * y + 2 * along_x * x
    jacobian[:, 0, 1] = slope * x * y + 2 * along_x * y + 2 * along_y * x
    jacobian[:, 1, 0] = jacobian[:, 0, 1]
    return value, jacobian


def inverted(function, wanted: Array, size: float) -> Array:  # type: ignore[no-untyped-def]
    """Return xy with ``function(xy) = wanted`` on the branch around the centre, else NaN.

    Newton's steps are kept short, so that a point beyond the fold ends as NaN, not on the far
    side of it.
    """
    xy = wanted.copy()
    tolerance = _NEWTON_TOLERANCE * size
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON_STEPS):
            value, jacobian = function(xy)
            step = np.einsum("nij,nj->ni", inverse_2x2(jacobian), wanted - value)
            longest = 0.25 * size + 0.5 * np.hypot(xy[:, 0], xy[:, 1])
            length = np.hypot(step[:, 0], step[:, 1])
            xy = xy + step * np.minimum(1.0, longest / np.maximum(length, 1e-300))[:, None]
            if not np.any(length > tolerance):
                break
        value, jacobian = function(xy)
        close = np.hypot(*(value - wanted).T) <= 1e-12 * (size + np.hypot(*wanted.T))
        determinant = np.linalg.det(jacobian)
        upright = (determinant > 0.0) & (np.trace(jacobian, axis1=1, axis2=2) > 0.0)
    return np.where((close & upright)[:, None], xy, np.nan)


def inverse_2x2(matrices: Array) -> Array:
    """Return the inverses of (N, 2, 2) matrices."""
    a, b = matrices[:, 0, 0], matrices[:, 0, 1]
    c, d = matrices[:, 1, 0], matrices[:, 1, 1]
    adjugate = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], axis=-2)
    return np.asarray(adjugate / (a * d - b * c)[:, None, None])
