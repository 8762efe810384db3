"""The measurement model and its least squares, compiled.

Eqs. 4, 5, 21 and 22 of the paper, with the lens and the circle's image, and their derivatives.
test/reference_model.py says the same in plain numpy, with the paper's own parameters; the tests
hold the two against each other. docs/measurement_model.md derives what stands here.

The unknowns are not Euler angles, which fail at beta = ±90°, but small turns: with X_0 the centre
of the targets, ``X_M = R_p (X - X_0) + d_0`` and ``R_p <- exp([ω]x) R_p``. The order is
(ω_x, ω_y, ω_z, d_0x, d_0y, d_0z, γ_s), all in the machine frame; ω in rad, d_0 in mm.

What the kernels take has names (:class:`PixelModel` and others) in model.py.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from omm_core.imaging.kernels import FASTMATH, lens_pixel, set_outline_weights
from omm_core.part_pose.model import Camera, Room

_compiled = njit(cache=True, error_model="numpy", fastmath=FASTMATH)
# What is called for every observation: an array costs nine words to hand over.
_inlined = njit(cache=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)


@_inlined
def set_camera(model, image, gamma_s, camera):
    """Fill the :class:`Camera` of one image.

    ``p = R_calibᵀ (R_sᵀ R_CNCᵀ (X_M - d_CNC) - d_calib)`` is eq. 4 with eq. 21 put in; only R_s
    depends on γ_s, which replaces the paper's eqs. 26 and 27.
    """
    R_calib, d_calib, R_cnc, d_cnc = model.R_calib, model.d_calib, model.R_cnc, model.d_cnc
    A, b, dA, db = camera.A, camera.b, camera.dA, camera.db
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
def predict_circle(model, room, t, R, d0, J):
    """Return (col, row) of a circle, and fill J (2, 7); NaN where it is not seen."""
    points, camera, lens = model.points, room.camera, model.lens
    A, b, dA, db = camera.A, camera.b, camera.dA, camera.db
    outline, by_machine, by_gamma, weights = (
        room.outline,
        room.by_machine,
        room.by_gamma,
        room.weights,
    )
    count = points.shape[1]
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
    set_outline_weights(outline, model.centre_kind, weights)
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
def predict_all(model, R, d0, gamma_s, pixels, jacobians):
    """Fill the predicted pixels (N, 2) and their derivatives (N, 2, 7).

    What the camera cannot see has NaN and 0.
    """
    room = workspace(model.points.shape[1])
    A, b, dA, db = room.camera
    lens, points = model.lens, model.points
    image_of, target_of = model.image_of, model.target_of
    last = -1
    for n in range(image_of.size):
        if image_of[n] != last:
            last = image_of[n]
            set_camera(model, last, gamma_s, room.camera)
        J = jacobians[n]
        if points.shape[1] == 1:
            col, row = predict_point(lens, A, b, dA, db, points, target_of[n], R, d0, J)
        else:
            col, row = predict_circle(model, room, target_of[n], R, d0, J)
        pixels[n, 0], pixels[n, 1] = col, row
        if math.isnan(pixels[n, 0]):
            for k in range(7):
                J[0, k] = J[1, k] = 0.0


@_compiled
def workspace(count):
    """Return the :class:`Room` for ``count`` points of each target."""
    camera = Camera(np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3))
    return Room(
        camera, np.empty((count, 2)), np.empty((count, 2, 3)), np.empty((count, 2)),
        np.empty((count, 2, 2)), np.empty((2, 7)),
    )  # fmt: skip


@_compiled
def normal_equations(model, measured, state, room, normal):
    """Fill the :class:`Normal` equations of a state; return rᵀWr, infinite if not all is seen."""
    image_of, target_of = model.image_of, model.target_of
    centres, information = measured.centres, measured.information
    N, g, J = normal.N, normal.g, room.J
    R, d0, gamma_s = state.R, state.d0, state.gamma_s[0]
    A, b, dA, db = room.camera
    lens, points = model.lens, model.points
    N[:, :] = 0.0
    g[:] = 0.0
    cost = 0.0
    last = -1
    for n in range(image_of.size):
        if image_of[n] != last:
            last = image_of[n]
            set_camera(model, last, gamma_s, room.camera)
        if points.shape[1] == 1:
            col, row = predict_point(lens, A, b, dA, db, points, target_of[n], R, d0, J)
        else:
            col, row = predict_circle(model, room, target_of[n], R, d0, J)
        r0, r1 = col - centres[n, 0], row - centres[n, 1]
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
