"""Covariance of a centre from the fit's own residuals, where these are more than noise.

What a camera does to edges (sharpening, resampling, JPEG, a printer's edge) errs alike in
neighbouring pixels, so it does not average out as noise does. The edge is cut into sectors whose
errors count as independent of each other (Liang and Zeger, Biometrika 73, 1986, eq. 6):

    C = H⁻¹ (Σ g_s g_sᵀ) H⁻¹ · n / (n - 5),    g_s the gradient of sector s,

5 for the ellipse, which takes that much of the errors along the edge away. What it takes away (a
shift of the whole dot, its size and shape) no residual shows: that part of a model's error remains
unseen here, and is what a survey's own sigma0 then finds.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.targets.conic.dot_model import PARAMETERS, linearise, place, shares, sort_pixels
from omm_core.targets.conic.outline import square_root

Floats = NDArray[np.float64]

SECTORS = 12
_OF_THE_ELLIPSE = 5
_SLOPES = np.array([7, 8, 10, 11])


def clustered_covariance(
    image: NDArray[Any],
    start: Floats,
    inner: float,
    bits: NDArray[np.int64],
    phase: float,
    noise: tuple[float, float],
    saturation: float,
    prior: Floats,
    p: Floats,
) -> Floats:
    """Return the covariance (2, 2) of the centre, px²; arguments as of `dot_fit.fit_dot`.

    Parameters
    ----------
    noise : read and gain of `dot_fit.fit_dot`.
    p : (12,) the solution.
    """
    a11, a12, a22 = square_root(start[2], start[3], start[4])
    reach = max(math.hypot(a11, a12), math.hypot(a12, a22))
    most = int(2.0 * (1.0 + 0.6 * (inner - 1.0)) * reach + 4.0) ** 2
    pixels, flat, geometry = np.empty((3, most)), np.zeros((2, 10)), np.empty((5, most))
    rows, rests, statistics = np.empty((PARAMETERS, most)), np.empty(most), np.zeros(6)
    read, gain = noise
    below = saturation - 4.5 * math.sqrt(read + gain * saturation)
    used = sort_pixels(image, start, p, inner, below, pixels, flat)
    place(pixels, used, p, geometry)
    shares(pixels, geometry, used, p, a11, a12, a22, inner, bits, phase)
    none = np.zeros(most, dtype=np.bool_)
    middle = (float(start[0]), float(start[1]), math.sqrt(a11 * a22 - a12 * a12))
    linearise(pixels, geometry, used, p, *middle, read, gain, none, rows, rests, statistics)
    rows, rests, pixels = rows[:, :used], rests[:used], pixels[:, :used]
    normal = rows @ rows.T
    for kind in range(2):
        at = slice(6 + 3 * kind, 9 + 3 * kind)
        one, x, y, xx, xy, yy = flat[kind, :6]
        weight = 1.0 / (read + gain * max(float(p[6 + 3 * kind]), 0.0))
        normal[at, at] += weight * np.array([[one, x, y], [x, xx, xy], [y, xy, yy]])
    normal[np.ix_(_SLOPES, _SLOPES)] += prior
    steps = np.linalg.solve(normal, np.eye(PARAMETERS)[:, :2]).T @ (rows * rests)
    angles = np.arctan2(pixels[1] - p[1], pixels[0] - p[0])
    sector = ((angles / (2.0 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    sums = np.array([steps[:, sector == s].sum(axis=1) for s in range(SECTORS)])
    return np.asarray(sums.T @ sums * SECTORS / (SECTORS - _OF_THE_ELLIPSE))
