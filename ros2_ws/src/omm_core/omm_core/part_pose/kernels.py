"""The measurement model and its least squares, compiled.

Eqs. 4, 5, 21 and 22 of the paper, with the lens and the circle's image, and their derivatives.
test/reference_model.py says the same in plain numpy, with the paper's own parameters; the tests
hold the two against each other. docs/measurement_model.md derives what stands here.

The unknowns are not Euler angles, which fail at beta = ±90°, but small turns: with X_0 the centre
of the targets, ``X_M = R_p (X - X_0) + d_0`` and ``R_p <- exp([ω]x) R_p``. The order is
(ω_x, ω_y, ω_z, d_0x, d_0y, d_0z, γ_s), all in the machine frame; ω in rad, d_0 in mm.

Arrays that all kernels take, in this order (I images, N observations, T targets, P points):

==================  ==========  ==========================================================
lens                (10,)       ``Lens.kernel_parameters()``
centre_kind         int         ``CircleCentre``
R_calib, d_calib    (3, 3) (3,) taper_T_camera
R_cnc, d_cnc        (I, 3, 3)   machine_T_spindle of each image, (I, 3)
image_of, target_of (N,)        which image and target an observation is of
points              (T, P, 3)   X - X_0; P = 1: the point itself, P = 8: points of the circle
==================  ==========  ==========================================================
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from omm_core.imaging.circle import ANGLES, BOUNDARY_POINTS, QUADRATURE_ANGLES
from omm_core.numerics.linear_algebra import copy_to, solve_damped

# Divisions need no check (NaN is checked where it matters); products may be fused and reordered.
_FASTMATH = {"contract", "reassoc", "arcp", "nsz"}
_compiled = njit(cache=True, error_model="numpy", fastmath=_FASTMATH)
# What is called for every observation: an array costs nine words to hand over.
_inlined = njit(cache=True, error_model="numpy", fastmath=_FASTMATH, forceinline=True)

_STILL = 8  # steps of 1e-2 standard deviations in all, after which no more are made

_COS1, _SIN1 = np.cos(ANGLES), np.sin(ANGLES)
_COS2, _SIN2 = np.cos(2 * ANGLES), np.sin(2 * ANGLES)
_Q_COS1, _Q_SIN1 = np.cos(QUADRATURE_ANGLES), np.sin(QUADRATURE_ANGLES)
_Q_COS2, _Q_SIN2 = np.cos(2 * QUADRATURE_ANGLES), np.sin(2 * QUADRATURE_ANGLES)


@_inlined
def _polynomial(x, y, k1, k2, k3, p1, p2):
    """Return Brown's polynomial and its derivative, see lens._polynomial."""
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
    fx, fy, k1, k2, k3, p1, p2 = lens[1], lens[2], lens[5], lens[6], lens[7], lens[8], lens[9]
    if lens[0] == 1.0:
        a, b, xx, xy, yy = _polynomial(x, y, k1, k2, k3, p1, p2)
        r2 = x * x + y * y
        if 1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3)) <= 0.0 or r2 > 16.0:
            a = np.nan
        return fx * a + lens[3], fy * b + lens[4], fx * xx, fx * xy, fy * xy, fy * yy
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
        a + lens[3], b + lens[4],
        fx * yy * inverse, -fy * xy * inverse, -fx * xy * inverse, fy * xx * inverse,
    )  # fmt: skip


@_inlined
def set_camera(R_calib, d_calib, R_cnc, d_cnc, image, gamma_s, A, b, dA, db):
    """Fill ``p_in_camera = A X_M + b`` of one image, and its derivative by γ_s: dA X_M + db.

    ``p = R_calibᵀ (R_sᵀ R_CNCᵀ (X_M - d_CNC) - d_calib)`` is eq. 4 with eq. 21 put in; only R_s
    depends on γ_s, which replaces the paper's eqs. 26 and 27.
    """
    c, s = math.cos(gamma_s), math.sin(gamma_s)
    for i in range(3):
        b[i] = 0.0
        db[i] = 0.0
        for j in range(3):
            # q = R_CNCᵀ (X_M - d_CNC); R_sᵀ q = (c q_x - s q_y, s q_x + c q_y, q_z)
            q_x, q_y, q_z = R_cnc[image, j, 0], R_cnc[image, j, 1], R_cnc[image, j, 2]
            t_x, t_y = c * q_x - s * q_y, s * q_x + c * q_y
            A[i, j] = R_calib[0, i] * t_x + R_calib[1, i] * t_y + R_calib[2, i] * q_z
            dA[i, j] = -R_calib[0, i] * t_y + R_calib[1, i] * t_x
            b[i] -= A[i, j] * d_cnc[image, j] + R_calib[j, i] * d_calib[j]
            db[i] -= dA[i, j] * d_cnc[image, j]


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


@_inlined
def predict_point(lens, A, b, dA, db, points, t, R, d0, J):
    """Return (col, row) of a point, and fill J (2, 7): the paper's model, without circles."""
    X0, X1, X2 = points[t, 0, 0], points[t, 0, 1], points[t, 0, 2]
    r0 = R[0, 0] * X0 + R[0, 1] * X1 + R[0, 2] * X2
    r1 = R[1, 0] * X0 + R[1, 1] * X1 + R[1, 2] * X2
    r2 = R[2, 0] * X0 + R[2, 1] * X1 + R[2, 2] * X2
    m0, m1, m2 = r0 + d0[0], r1 + d0[1], r2 + d0[2]
    w = A[2, 0] * m0 + A[2, 1] * m1 + A[2, 2] * m2 + b[2]
    if not w > 0.0:
        return np.nan, np.nan
    h = 1.0 / w
    x = h * (A[0, 0] * m0 + A[0, 1] * m1 + A[0, 2] * m2 + b[0])
    y = h * (A[1, 0] * m0 + A[1, 1] * m1 + A[1, 2] * m2 + b[1])
    col, row, l00, l01, l10, l11 = lens_pixel(lens, x, y)
    l00, l01, l10, l11 = l00 * h, l01 * h, l10 * h, l11 * h
    l02, l12 = -(l00 * x + l01 * y), -(l10 * x + l11 * y)
    a0 = l00 * A[0, 0] + l01 * A[1, 0] + l02 * A[2, 0]
    a1 = l00 * A[0, 1] + l01 * A[1, 1] + l02 * A[2, 1]
    a2 = l00 * A[0, 2] + l01 * A[1, 2] + l02 * A[2, 2]
    b0 = l10 * A[0, 0] + l11 * A[1, 0] + l12 * A[2, 0]
    b1 = l10 * A[0, 1] + l11 * A[1, 1] + l12 * A[2, 1]
    b2 = l10 * A[0, 2] + l11 * A[1, 2] + l12 * A[2, 2]
    g0 = dA[0, 0] * m0 + dA[0, 1] * m1 + dA[0, 2] * m2 + db[0]
    g1 = dA[1, 0] * m0 + dA[1, 1] * m1 + dA[1, 2] * m2 + db[1]
    g2 = dA[2, 0] * m0 + dA[2, 1] * m1 + dA[2, 2] * m2 + db[2]
    # d(X_M)/dω_j = e_j x (R_p Y)
    J[0, 0], J[0, 1], J[0, 2] = a2 * r1 - a1 * r2, a0 * r2 - a2 * r0, a1 * r0 - a0 * r1
    J[1, 0], J[1, 1], J[1, 2] = b2 * r1 - b1 * r2, b0 * r2 - b2 * r0, b1 * r0 - b0 * r1
    J[0, 3], J[0, 4], J[0, 5] = a0, a1, a2
    J[1, 3], J[1, 4], J[1, 5] = b0, b1, b2
    J[0, 6] = l00 * g0 + l01 * g1 + l02 * g2
    J[1, 6] = l10 * g0 + l11 * g1 + l12 * g2
    return col, row


@_inlined
def predict(lens, kind, A, b, dA, db, points, t, R, d0, outline, by_machine, by_gamma, weights, J):
    """Return (col, row) of target t, and fill J (2, 7); NaN where the camera cannot see it.

    ``outline`` (P, 2), ``by_machine`` (P, 2, 3), ``by_gamma`` (P, 2), ``weights`` (P, 2, 2) are
    room to work in.
    """
    count = points.shape[1]
    if count == 1:
        return predict_point(lens, A, b, dA, db, points, t, R, d0, J)
    for k in range(count):
        X0, X1, X2 = points[t, k, 0], points[t, k, 1], points[t, k, 2]
        m0 = R[0, 0] * X0 + R[0, 1] * X1 + R[0, 2] * X2 + d0[0]
        m1 = R[1, 0] * X0 + R[1, 1] * X1 + R[1, 2] * X2 + d0[1]
        m2 = R[2, 0] * X0 + R[2, 1] * X1 + R[2, 2] * X2 + d0[2]
        u = A[0, 0] * m0 + A[0, 1] * m1 + A[0, 2] * m2 + b[0]
        v = A[1, 0] * m0 + A[1, 1] * m1 + A[1, 2] * m2 + b[1]
        w = A[2, 0] * m0 + A[2, 1] * m1 + A[2, 2] * m2 + b[2]
        if not w > 0.0:
            return np.nan, np.nan
        x, y = u / w, v / w
        col, row, l00, l01, l10, l11 = lens_pixel(lens, x, y)
        outline[k, 0] = col
        outline[k, 1] = row
        # d(pixel)/d(p) = lens (2 x 2) times the pinhole [[1, 0, -x], [0, 1, -y]] / w (eq. 16)
        l00, l01, l10, l11 = l00 / w, l01 / w, l10 / w, l11 / w
        l02, l12 = -(l00 * x + l01 * y), -(l10 * x + l11 * y)
        for j in range(3):
            by_machine[k, 0, j] = l00 * A[0, j] + l01 * A[1, j] + l02 * A[2, j]
            by_machine[k, 1, j] = l10 * A[0, j] + l11 * A[1, j] + l12 * A[2, j]
        g0 = dA[0, 0] * m0 + dA[0, 1] * m1 + dA[0, 2] * m2 + db[0]
        g1 = dA[1, 0] * m0 + dA[1, 1] * m1 + dA[1, 2] * m2 + db[1]
        g2 = dA[2, 0] * m0 + dA[2, 1] * m1 + dA[2, 2] * m2 + db[2]
        by_gamma[k, 0] = l00 * g0 + l01 * g1 + l02 * g2
        by_gamma[k, 1] = l10 * g0 + l11 * g1 + l12 * g2
    set_outline_weights(outline, kind, weights)
    J[:, :] = 0.0
    centre_col = centre_row = 0.0
    for k in range(count):
        X0, X1, X2 = points[t, k, 0], points[t, k, 1], points[t, k, 2]
        r0 = R[0, 0] * X0 + R[0, 1] * X1 + R[0, 2] * X2
        r1 = R[1, 0] * X0 + R[1, 1] * X1 + R[1, 2] * X2
        r2 = R[2, 0] * X0 + R[2, 1] * X1 + R[2, 2] * X2
        for i in range(2):
            w0, w1 = weights[k, i, 0], weights[k, i, 1]
            h0 = w0 * by_machine[k, 0, 0] + w1 * by_machine[k, 1, 0]
            h1 = w0 * by_machine[k, 0, 1] + w1 * by_machine[k, 1, 1]
            h2 = w0 * by_machine[k, 0, 2] + w1 * by_machine[k, 1, 2]
            # d(X_M)/dω_j = e_j x (R_p Y)
            J[i, 0] += h2 * r1 - h1 * r2
            J[i, 1] += h0 * r2 - h2 * r0
            J[i, 2] += h1 * r0 - h0 * r1
            J[i, 3] += h0
            J[i, 4] += h1
            J[i, 5] += h2
            J[i, 6] += w0 * by_gamma[k, 0] + w1 * by_gamma[k, 1]
        centre_col += weights[k, 0, 0] * outline[k, 0] + weights[k, 0, 1] * outline[k, 1]
        centre_row += weights[k, 1, 0] * outline[k, 0] + weights[k, 1, 1] * outline[k, 1]
    return centre_col, centre_row


@_compiled
def predict_all(lens, kind, R_calib, d_calib, R_cnc, d_cnc, image_of, target_of, points, R, d0,
                gamma_s, pixels, jacobians):  # fmt: skip
    """Fill the predicted pixels (N, 2) and their derivatives (N, 2, 7).

    What the camera cannot see has NaN and 0.
    """
    count = points.shape[1]
    A, b, dA, db = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3)
    outline, by_machine = np.empty((count, 2)), np.empty((count, 2, 3))
    by_gamma, weights = np.empty((count, 2)), np.empty((count, 2, 2))
    last = -1
    for n in range(image_of.size):
        if image_of[n] != last:
            last = image_of[n]
            set_camera(R_calib, d_calib, R_cnc, d_cnc, last, gamma_s, A, b, dA, db)
        pixels[n, 0], pixels[n, 1] = predict(
            lens, kind, A, b, dA, db, points, target_of[n], R, d0,
            outline, by_machine, by_gamma, weights, jacobians[n],
        )  # fmt: skip
        if math.isnan(pixels[n, 0]):
            for k in range(7):
                jacobians[n, 0, k] = jacobians[n, 1, k] = 0.0


@_compiled
def workspace(count):
    """Return the arrays that normal_equations works in, for ``count`` points of each target."""
    return (
        np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3), np.empty((count, 2)),
        np.empty((count, 2, 3)), np.empty((count, 2)), np.empty((count, 2, 2)), np.empty((2, 7)),
    )  # fmt: skip


@_compiled
def normal_equations(lens, kind, R_calib, d_calib, R_cnc, d_cnc, image_of, target_of, points,
                     measured, information, R, d0, gamma_s, N, g, room):  # fmt: skip
    """Fill N = JᵀWJ (7, 7) and g = Jᵀ W r (7,); return rᵀWr, infinite where not all is seen.

    ``information`` (N, 3) holds W of each observation as (col col, col row, row row); ``room`` is
    :func:`workspace` for P points.
    """
    A, b, dA, db, outline, by_machine, by_gamma, weights, J = room
    N[:, :] = 0.0
    g[:] = 0.0
    cost = 0.0
    last = -1
    for n in range(image_of.size):
        if image_of[n] != last:
            last = image_of[n]
            set_camera(R_calib, d_calib, R_cnc, d_cnc, last, gamma_s, A, b, dA, db)
        col, row = predict(
            lens, kind, A, b, dA, db, points, target_of[n], R, d0,
            outline, by_machine, by_gamma, weights, J,
        )  # fmt: skip
        r0, r1 = col - measured[n, 0], row - measured[n, 1]
        w00, w01, w11 = information[n, 0], information[n, 1], information[n, 2]
        wr0, wr1 = w00 * r0 + w01 * r1, w01 * r0 + w11 * r1
        cost += r0 * wr0 + r1 * wr1
        if not cost < np.inf:
            return np.inf
        for i in range(7):
            a0, a1 = w00 * J[0, i] + w01 * J[1, i], w01 * J[0, i] + w11 * J[1, i]
            g[i] += J[0, i] * wr0 + J[1, i] * wr1
            for j in range(7):  # all, though N is symmetric: in whole vectors that is faster
                N[i, j] += a0 * J[0, j] + a1 * J[1, j]
    return cost


@_compiled
def rotate(R, wx, wy, wz, rotated):
    """Fill exp([ω]x) R (Rodrigues)."""
    angle2 = wx * wx + wy * wy + wz * wz
    if angle2 < 1e-12:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = math.sqrt(angle2)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    c = 1.0 - b * angle2
    e00, e11, e22 = c + b * wx * wx, c + b * wy * wy, c + b * wz * wz
    e01, e10 = b * wx * wy - a * wz, b * wx * wy + a * wz
    e02, e20 = b * wx * wz + a * wy, b * wx * wz - a * wy
    e12, e21 = b * wy * wz - a * wx, b * wy * wz + a * wx
    for j in range(3):
        r0, r1, r2 = R[0, j], R[1, j], R[2, j]
        rotated[0, j] = e00 * r0 + e01 * r1 + e02 * r2
        rotated[1, j] = e10 * r0 + e11 * r1 + e12 * r2
        rotated[2, j] = e20 * r0 + e21 * r1 + e22 * r2


@_compiled
def gauss_newton(lens, kind, R_calib, d_calib, R_cnc, d_cnc, image_of, target_of, points,
                 measured, information, size, iterations, tolerance,
                 R, d0, gamma, N):  # fmt: skip
    """Minimise rᵀWr from a start (eqs. 9 to 13), damped where a step does not lower it.

    Parameters
    ----------
    size : int
        7, or 6 with γ_s given.
    tolerance : float
        A step shorter than this many standard deviations is the last one. Steps shrink by 1000
        or more each time (test_circle_centre.py), so that what is left is as much smaller.
    R, d0, gamma : (3, 3), (3,), (1,) arrays
        The start, replaced by the solution.
    N : (7, 7) array
        Filled with the normal matrix at the solution.

    Returns
    -------
    cost : float
        rᵀWr; infinite where the start does not see all targets.
    used : int
        Iterations, negative where not converged.
    """
    room = workspace(points.shape[1])
    g, step, L = np.empty(7), np.zeros(7), np.empty((7, 7))
    N_new, g_new = np.empty((7, 7)), np.empty(7)
    R_new, d_new = np.empty((3, 3)), np.empty(3)
    cost = normal_equations(lens, kind, R_calib, d_calib, R_cnc, d_cnc, image_of, target_of,
                            points, measured, information, R, d0, gamma[0], N, g,
                            room)  # fmt: skip
    if not cost < np.inf:
        return cost, -1
    damping, still = 0.0, 0
    for iteration in range(1, iterations + 1):
        if not solve_damped(N, g, size, damping, L, step):
            if damping > 1e12:
                return cost, -iteration
            damping = max(10.0 * damping, 1e-6)
            continue
        length2 = 0.0  # of the step, in standard deviations
        for i in range(size):
            for j in range(size):
                length2 += step[i] * N[i, j] * step[j]
        last = length2 < tolerance * tolerance
        rotate(R, step[0], step[1], step[2], R_new)
        for i in range(3):
            d_new[i] = d0[i] + step[3 + i]
        gamma_new = gamma[0] + (step[6] if size == 7 else 0.0)
        cost_new = normal_equations(
            lens, kind, R_calib, d_calib, R_cnc, d_cnc, image_of, target_of,
            points, measured, information, R_new, d_new, gamma_new, N_new, g_new,
            room,
        )  # fmt: skip
        # The cost falls by the square of the step: for a short one by less than its last digits
        # hold, or by less than the derivatives of a large circle's image are off (1e-5 of them),
        # so that it may seem to rise.
        short = length2 < 1e-4 + 1e-10 * cost
        if cost_new <= cost or (short and cost_new < np.inf):
            cost = cost_new
            copy_to(R, R_new)
            copy_to(N, N_new)
            for i in range(3):
                d0[i] = d_new[i]
            for i in range(7):
                g[i] = g_new[i]
            gamma[0] = gamma_new
            # Where the model bends within its last digits, steps may end to and fro.
            still += short and damping < 1e-3
            if (last and damping < 1e-3) or still > _STILL:
                return cost, iteration
            damping = damping * 0.1 if damping > 1e-9 else 0.0
        else:
            damping = max(10.0 * damping, 1e-4)
    return cost, -iterations
