"""The quadratic function that rays leave of the part's rotation (see `start`), and its minima."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from omm_core.imaging.kernels import FASTMATH
from omm_core.numerics.linear_algebra import copy_to, solve_damped
from omm_core.part_pose.kernels import rotate, set_camera
from omm_core.part_pose.model import Camera

Array = NDArray[np.float64]


class Sights(NamedTuple):
    """Unit rays (N, 3) in the camera, targets X - X_0 (N, 3), the rest as in PixelModel."""

    rays: Array
    R_calib: Array
    d_calib: Array
    R_cnc: Array
    d_cnc: Array
    image_of: NDArray[np.int64]
    X: Array


class _Quadratic(NamedTuple):
    """cost = rᵀ M r + 2 mᵀ r + c and d = D r + d_free, with r = R row by row."""

    M: Array
    m: Array
    D: Array
    d_free: Array


class _Sums(NamedTuple):
    """Σ P, Σ K and Σ P o over the rays: what d depends on."""

    S: Array
    T: Array
    s: Array


class Minima(NamedTuple):
    """Poses, each R (9,) row by row, d_0 (3,), γ_s, and its cost."""

    R: Array
    d0: Array
    gamma_s: Array
    cost: Array


@njit(cache=True)
def _set_quadratic(sights, gamma_s, quadratic):
    """Fill the quadratic for one γ_s; return c, and whether the rays fix a point at all."""
    sums = _Sums(np.zeros((3, 3)), np.zeros((3, 9)), np.zeros(3))
    c = _add_rays(sights, gamma_s, quadratic, sums)
    inverse = np.empty((3, 3))
    determinant = _adjugate(sums.S, inverse)
    if not determinant > 1e-12 * sights.image_of.size**3:
        return c, False
    # d = -S⁻¹ (T r - s)
    M, m, D, d_free = quadratic.M, quadratic.m, quadratic.D, quadratic.d_free
    T, s = sums.T, sums.s
    for i in range(3):
        d_free[i] = 0.0
        for j in range(3):
            d_free[i] += inverse[i, j] * s[j] / determinant
        for k in range(9):
            D[i, k] = 0.0
            for j in range(3):
                D[i, k] -= inverse[i, j] * T[j, k] / determinant
    # With d put in: M + TᵀD, m + Tᵀ d_free, c - sᵀ d_free.
    for i in range(9):
        for j in range(9):
            for k in range(3):
                M[i, j] += T[k, i] * D[k, j]
        for k in range(3):
            m[i] += T[k, i] * d_free[k]
    for k in range(3):
        c -= s[k] * d_free[k]
    return c, True


@njit(cache=True)
def _add_rays(sights, gamma_s, quadratic, sums):
    """Fill M and m with d still free, and the sums; return c.

    e = P (K r + d - o) with K r = R X; P is a projection, so PᵀP = P.
    """
    M, m, S, T, s = quadratic.M, quadratic.m, sums.S, sums.T, sums.s
    rays, X, image_of = sights.rays, sights.X, sights.image_of
    camera = Camera(np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3))
    A, b = camera.A, camera.b
    v, o, P, Po = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty(3)
    K = np.empty((3, 9))
    M[:, :] = 0.0
    m[:] = 0.0
    c = 0.0
    last = -1
    for n in range(image_of.size):
        if image_of[n] != last:
            last = image_of[n]
            set_camera(sights, last, gamma_s, camera)
        _project(A, b, rays[n], v, o, P, Po)
        for i in range(3):
            c += o[i] * Po[i]
            for j in range(3):
                S[i, j] += P[i, j]
                for k in range(3):
                    K[i, 3 * j + k] = P[i, j] * X[n, k]
                    T[i, 3 * j + k] += K[i, 3 * j + k]
            s[i] += Po[i]
        for i in range(3):
            for k in range(3):
                m[3 * i + k] -= X[n, k] * Po[i]
                for j in range(9):
                    M[3 * i + k, j] += X[n, k] * K[i, j]
    return c


@njit(cache=True, forceinline=True)
def _project(A, b, ray, v, o, P, Po):
    """Fill the ray v in the machine, the camera's centre o, P = I - v vᵀ, and P o."""
    for i in range(3):
        v[i] = A[0, i] * ray[0] + A[1, i] * ray[1] + A[2, i] * ray[2]
        o[i] = -(A[0, i] * b[0] + A[1, i] * b[1] + A[2, i] * b[2])
    for i in range(3):
        Po[i] = 0.0
        for j in range(3):
            P[i, j] = (1.0 if i == j else 0.0) - v[i] * v[j]
            Po[i] += P[i, j] * o[j]


@njit(cache=True)
def _adjugate(S, adjugate):
    """Fill the adjugate of a symmetric matrix (3, 3); return its determinant."""
    c00, c01 = S[1, 1] * S[2, 2] - S[1, 2] * S[2, 1], S[0, 2] * S[2, 1] - S[0, 1] * S[2, 2]
    c02 = S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1]
    adjugate[0, 0], adjugate[0, 1], adjugate[0, 2] = c00, c01, c02
    adjugate[1, 0] = S[1, 2] * S[2, 0] - S[1, 0] * S[2, 2]
    adjugate[1, 1] = S[0, 0] * S[2, 2] - S[0, 2] * S[2, 0]
    adjugate[1, 2] = S[0, 2] * S[1, 0] - S[0, 0] * S[1, 2]
    adjugate[2, 0] = S[1, 0] * S[2, 1] - S[1, 1] * S[2, 0]
    adjugate[2, 1] = S[0, 1] * S[2, 0] - S[0, 0] * S[2, 1]
    adjugate[2, 2] = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    return S[0, 0] * c00 + S[1, 0] * c01 + S[2, 0] * c02


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)
def _descend(quadratic, c, R, found, first, count):
    """Minimise the quadratic over rotations from R (Gauss-Newton, damped).

    Return the cost, and whether it leads to one of the minima ``found[first:count]``.
    """
    M, m = quadratic.M, quadratic.m
    r, Mr, G = np.empty(9), np.empty(9), np.zeros((9, 3))
    N, g, L, step = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.zeros(3)
    R_new = np.empty((3, 3))
    cost = np.inf
    damping = 1e-3
    copy_to(R_new, R)
    for _ in range(40):
        for i in range(3):
            for k in range(3):
                r[3 * i + k] = R_new[i, k]
        new = c
        for i in range(9):
            Mr[i] = m[i]
            for j in range(9):
                Mr[i] += M[i, j] * r[j]
            new += r[i] * (Mr[i] + m[i])
        if new <= cost:
            settled = cost - new <= 1e-10 * abs(new)
            cost = new
            copy_to(R, R_new)
            for f in range(first, count):
                trace = 0.0
                for i in range(9):
                    trace += found.R[f, i] * r[i]
                if trace > 3.0 - 1e-5:
                    return cost, True
            if settled:
                break
            damping *= 0.2
            _set_slope(M, Mr, R, G, N, g)
        else:
            damping = max(1e-3, damping * 8.0)
        if not solve_damped(N, g, N.shape[0], damping, L, step):
            damping = max(1e-3, damping * 8.0)
            if damping > 1e9:
                break
            continue
        rotate(R, step[0], step[1], step[2], R_new)
    return cost, False


@njit(cache=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def _set_slope(M, Mr, R, G, N, g):
    """Fill G = d(r)/dω (its zeros stand there), and the normal equations N (3, 3), g (3,)."""
    for k in range(3):
        # d(R)/dω = [e_j]x R: row 0 of R turns into rows 1 and 2, and so on.
        G[k, 1], G[k, 2] = R[2, k], -R[1, k]
        G[3 + k, 0], G[3 + k, 2] = -R[2, k], R[0, k]
        G[6 + k, 0], G[6 + k, 1] = R[1, k], -R[0, k]
    g[:] = 0.0
    N[:, :] = 0.0
    for i in range(9):
        h0 = h1 = h2 = 0.0  # row i of M G
        for j in range(9):
            h0 += M[i, j] * G[j, 0]
            h1 += M[i, j] * G[j, 1]
            h2 += M[i, j] * G[j, 2]
        for a in range(3):
            g[a] += G[i, a] * Mr[i]
            N[a, 0] += G[i, a] * h0
            N[a, 1] += G[i, a] * h1
            N[a, 2] += G[i, a] * h2


@njit(cache=True)
def find_minima(sights, gammas, cube, found):
    """Fill the minima (G * C of them, at most) for each γ_s; return how many."""
    quadratic = _Quadratic(np.empty((9, 9)), np.empty(9), np.empty((3, 9)), np.empty(3))
    R = np.empty((3, 3))
    count = 0
    for gamma in gammas:
        c, good = _set_quadratic(sights, gamma, quadratic)
        if not good:
            continue
        first = count
        for s in range(cube.shape[0]):
            copy_to(R, cube[s])
            cost, known = _descend(quadratic, c, R, found, first, count)
            if known:
                continue
            for i in range(9):
                found.R[count, i] = R[i // 3, i % 3]
            for i in range(3):
                found.d0[count, i] = quadratic.d_free[i]
                for j in range(9):
                    found.d0[count, i] += quadratic.D[i, j] * R[j // 3, j % 3]
            found.gamma_s[count] = gamma
            found.cost[count] = cost
            count += 1
    return count
