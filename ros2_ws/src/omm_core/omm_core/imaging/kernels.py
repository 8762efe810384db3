"""Lens and circle of a point in front of the camera, compiled: lens.py and circle.py say the same.

The derivatives are by the ray (lens), and of the circle's centre by its outline (circle.py).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from omm_core.imaging.circle import ANGLES, BOUNDARY_POINTS, QUADRATURE_ANGLES
from omm_core.imaging.lens import LensNumbers

# Divisions need no check (NaN is checked where it matters); products may be fused and reordered.
FASTMATH = {"contract", "reassoc", "arcp", "nsz"}
_compiled = njit(cache=True, error_model="numpy", fastmath=FASTMATH)
# What is called for every observation: an array costs nine words to hand over.
_inlined = njit(cache=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)

# Where ``Lens.kernel_parameters`` holds each number. (As a NamedTuple of ten numbers the lens is
# read in another order, which turns the last bit of what is solved.)
_PLUMB_BOB, _FX, _FY, _COL, _ROW, _K1, _K2, _K3, _P1, _P2 = range(len(LensNumbers._fields))

_COS1, _SIN1 = np.cos(ANGLES), np.sin(ANGLES)
_COS2, _SIN2 = np.cos(2 * ANGLES), np.sin(2 * ANGLES)
_Q_COS1, _Q_SIN1 = np.cos(QUADRATURE_ANGLES), np.sin(QUADRATURE_ANGLES)
_Q_COS2, _Q_SIN2 = np.cos(2 * QUADRATURE_ANGLES), np.sin(2 * QUADRATURE_ANGLES)


@_inlined
def _polynomial(x, y, k1, k2, k3, p1, p2):
    """Brown's polynomial and its derivative, see `distortion.brown_polynomial`."""
    r2 = x * x + y * y
    scale = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    value_x = x * scale + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y
    value_y = y * scale + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y
    xx = scale + slope * x * x + 6.0 * p1 * x + 2.0 * p2 * y
    yy = scale + slope * y * y + 6.0 * p2 * y + 2.0 * p1 * x
    xy = slope * x * y + 2.0 * p1 * y + 2.0 * p2 * x
    return value_x, value_y, xx, xy, yy


@_inlined
def lens_pixel(lens, x, y):
    """Return (col, row) of a ray (x, y, 1), and d(col, row)/d(x, y); NaN where not seen."""
    fx, fy, k1, k2, k3 = lens[_FX], lens[_FY], lens[_K1], lens[_K2], lens[_K3]
    p1, p2 = lens[_P1], lens[_P2]
    if lens[_PLUMB_BOB] == 1.0:
        a, b, xx, xy, yy = _polynomial(x, y, k1, k2, k3, p1, p2)
        r2 = x * x + y * y
        if 1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3)) <= 0.0 or r2 > 16.0:
            a = np.nan
        return fx * a + lens[_COL], fy * b + lens[_ROW], fx * xx, fx * xy, fy * xy, fy * yy
    ideal_x, ideal_y = fx * x, fy * y
    shrink = 1.0 / (1.0 + k1 * (ideal_x * ideal_x + ideal_y * ideal_y))
    if not 0.5 < shrink < 2.0:
        shrink = 1.0
    a, b = ideal_x * shrink, ideal_y * shrink
    xx, xy, yy, inverse = 1.0, 0.0, 1.0, 1.0
    found = False
    for _ in range(30):
        value_x, value_y, xx, xy, yy = _polynomial(a, b, k1, k2, k3, p1, p2)
        determinant = xx * yy - xy * xy
        inverse = 1.0 / determinant
        error_x, error_y = ideal_x - value_x, ideal_y - value_y
        step_x = (yy * error_x - xy * error_y) * inverse
        step_y = (xx * error_y - xy * error_x) * inverse
        a += step_x
        b += step_y
        if abs(step_x) + abs(step_y) < 1e-5:
            # Newton squares its error: what is left is below 1e-12 px. The derivative is of
            # 1e-5 px beside, which changes it by 1e-9.
            found = determinant > 0.0 and xx + yy > 0.0
            break
    if not found:
        a = np.nan
    return (
        a + lens[_COL], b + lens[_ROW],
        fx * yy * inverse, -fy * xy * inverse, -fx * xy * inverse, fy * xx * inverse,
    )  # fmt: skip


@_compiled
def set_outline_weights(outline, kind, weights):
    """Fill the matrices B_k of ``centre = Σ B_k m_k``, see circle.centre_weights."""
    ux = uy = vx = vy = 0.0
    for k in range(BOUNDARY_POINTS):
        ux += _COS1[k] * outline[k, 0]
        uy += _COS1[k] * outline[k, 1]
        vx += _SIN1[k] * outline[k, 0]
        vy += _SIN1[k] * outline[k, 1]
    if kind == 0:
        # T diag(1/2, -1/2) T⁻¹ and T [[0, 1/2], [1/2, 0]] T⁻¹ with T = [u v]
        h = 0.5 / (ux * vy - vx * uy)
        a00, a01, a10 = h * (ux * vy + vx * uy), -2 * h * ux * vx, 2 * h * uy * vy
        b00, b01, b10 = h * (vx * vy - ux * uy), h * (ux * ux - vx * vx), h * (vy * vy - uy * uy)
        a11, b11 = -a00, -b00
    else:
        g00 = g01 = g11 = c00 = c01 = c11 = s00 = s01 = s11 = 0.0
        for k in range(_Q_COS1.size):
            tx = vx * _Q_COS1[k] - ux * _Q_SIN1[k]
            ty = vy * _Q_COS1[k] - uy * _Q_SIN1[k]
            inverse = 1.0 / math.sqrt(tx * tx + ty * ty)
            n00, n01, n11 = ty * ty * inverse, -tx * ty * inverse, tx * tx * inverse
            g00 += n00
            g01 += n01
            g11 += n11
            c00 += _Q_COS2[k] * n00
            c01 += _Q_COS2[k] * n01
            c11 += _Q_COS2[k] * n11
            s00 += _Q_SIN2[k] * n00
            s01 += _Q_SIN2[k] * n01
            s11 += _Q_SIN2[k] * n11
        h = 1.0 / (g00 * g11 - g01 * g01)
        a00, a01 = h * (g11 * c00 - g01 * c01), h * (g11 * c01 - g01 * c11)
        a10, a11 = h * (g00 * c01 - g01 * c00), h * (g00 * c11 - g01 * c01)
        b00, b01 = h * (g11 * s00 - g01 * s01), h * (g11 * s01 - g01 * s11)
        b10, b11 = h * (g00 * s01 - g01 * s00), h * (g00 * s11 - g01 * s01)
    n = 1.0 / BOUNDARY_POINTS
    for k in range(BOUNDARY_POINTS):
        c2, s2 = 2.0 * _COS2[k], 2.0 * _SIN2[k]
        weights[k, 0, 0] = n * (1.0 + c2 * a00 + s2 * b00)
        weights[k, 0, 1] = n * (c2 * a01 + s2 * b01)
        weights[k, 1, 0] = n * (c2 * a10 + s2 * b10)
        weights[k, 1, 1] = n * (1.0 + c2 * a11 + s2 * b11)
