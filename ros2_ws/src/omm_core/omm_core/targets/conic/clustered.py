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

from omm_core.targets.conic.dot_model import (
    B0,
    BX,
    BY,
    F0,
    FX,
    FY,
    PARAMETERS,
    Noise,
    Ring,
    Window,
    linearise,
    place,
    shares,
    sort_pixels,
)
from omm_core.targets.conic.outline import COL, ROW, XX, XY, YY, square_root

Floats = NDArray[np.float64]

SECTORS = 12
_OF_THE_ELLIPSE = 5
_SLOPES = np.array([FX, FY, BX, BY])


def clustered_covariance(
    image: NDArray[Any],
    start: Floats,
    ring: Ring,
    noise: Noise,
    prior: Floats,
    p: Floats,
) -> Floats:
    """Return the covariance (2, 2) of the centre, px²; arguments as of `dot_fit.fit_dot`.

    Parameters
    ----------
    prior : (4, 4) information of the slopes.
    p : (12,) the solution.
    """
    a11, a12, a22 = square_root(start[XX], start[XY], start[YY])
    r0, reach = math.sqrt(a11 * a22 - a12 * a12), max(math.hypot(a11, a12), math.hypot(a12, a22))
    window = Window(float(start[COL]), float(start[ROW]), a11, a12, a22, r0, reach)
    most = int(2.0 * (1.0 + 0.6 * (ring.inner - 1.0)) * reach + 4.0) ** 2
    pixels, flat, geometry = np.empty((3, most)), np.zeros((2, 10)), np.empty((5, most))
    rows, rests, statistics = np.empty((PARAMETERS, most)), np.empty(most), np.zeros(6)
    read, gain = noise.read, noise.gain
    below = noise.saturation - 4.5 * math.sqrt(read + gain * noise.saturation)
    used = sort_pixels(image, start, p, ring.inner, below, pixels, flat)
    place(pixels, used, p, geometry)
    shares(pixels, geometry, used, p, window, ring)
    none = np.zeros(most, dtype=np.bool_)
    linearise(pixels, geometry, used, p, window, noise, none, rows, rests, statistics)
    rows, rests, pixels = rows[:, :used], rests[:used], pixels[:, :used]
    normal = rows @ rows.T
    for kind, level in enumerate((F0, B0)):
        at = slice(level, level + 3)
        one, x, y, xx, xy, yy = flat[kind, :6]
        weight = 1.0 / (read + gain * max(float(p[level]), 0.0))
        normal[at, at] += weight * np.array([[one, x, y], [x, xx, xy], [y, xy, yy]])
    normal[np.ix_(_SLOPES, _SLOPES)] += prior
    steps = np.linalg.solve(normal, np.eye(PARAMETERS)[:, :2]).T @ (rows * rests)
    angles = np.arctan2(pixels[1] - p[ROW], pixels[0] - p[COL])
    sector = ((angles / (2.0 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    sums = np.array([steps[:, sector == s].sum(axis=1) for s in range(SECTORS)])
    return np.asarray(sums.T @ sums * SECTORS / (SECTORS - _OF_THE_ELLIPSE))
