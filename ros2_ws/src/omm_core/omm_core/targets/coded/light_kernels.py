"""Planes of light through what is set and what is clear around a dot."""

from __future__ import annotations

import math

import numba
import numpy as np

from omm_core.numerics.linear_algebra import invert, product
from omm_core.targets.coded.ring_profile import phi
from omm_core.targets.conic.outline import square_root


@numba.njit(cache=True, error_model="numpy")
def _share(u, v, root, ring, s, bits, phase, beside):
    """Return the ring's share of the pixel at (u, v), dot radii.

    Parameters
    ----------
    root, ring : square root (a11, a12, a22) of the outline, px per dot radius; the ring's inner
        and outer radius. s : blur, px. bits, phase : what is set, from which angle on.
    beside : how near (dot radii) an edge inside the ring must not be.

    Returns
    -------
    share. z_out : how far inside the outer edge, in s. known : False where such an edge is near.
    """
    a11, a12, a22 = root
    inner, outer = ring
    det = a11 * a22 - a12 * a12
    n = len(bits)
    pitch = 2.0 * math.pi / n
    square = u * u + v * v
    rho = math.sqrt(square)
    if abs(rho - inner) < beside:
        return 0.0, 0.0, False
    # Pixels per dot radius across circles, and per radian across the sectors' borders.
    across = rho * det / math.sqrt((a22 * u - a12 * v) ** 2 + (a11 * v - a12 * u) ** 2)
    # What is round looks smaller when it is blurred, see `dot_model`.
    bulge = 0.5 * s * across**3 / det**2
    z_in = (rho - inner) * across / s + bulge / inner
    z_out = (outer - rho) * across / s - bulge / outer
    share = 0.0
    if z_in > -3.0:
        turn = (math.atan2(v, u) - phase) / pitch
        k = math.floor(turn + 0.5)
        before, after = bits[(k - 1) % n], bits[k % n]
        share = before + 0.0
        if before != after:
            if abs(turn - k) * pitch * rho < beside:
                return 0.0, 0.0, False
            along = math.sqrt((a11 * u + a12 * v) ** 2 + (a12 * u + a22 * v) ** 2)
            side = square * det / along
            share += (after - before) * phi((turn - k) * pitch * side / s)
        share *= phi(z_in) * phi(z_out)
    return share, z_out, True


@numba.njit(cache=True, error_model="numpy")
def _unknowns(share, tx, ty, g):
    """Fill what a grey value changes by with each of the eight unknowns of `ring_light` (8,)."""
    bend = tx * tx + ty * ty - 4.0
    g[0], g[1], g[2] = share, share * tx, share * ty
    g[3], g[4], g[5] = 1.0 - share, (1.0 - share) * tx, (1.0 - share) * ty
    g[6], g[7] = share * bend, (1.0 - share) * bend


@numba.njit(cache=True, error_model="numpy")
def ring_light(image, start, lean, inner, outer, bits, phase, s, saturation, mixed):
    """Return planes of light F and B through what lies around the dot, ring and gap.

    A pixel shows B + (F - B) R with R its share of the ring; where R is not almost 0 or 1 (nearer
    than `mixed`), a wrong radius would look like light, so edges are left out.

    Returns
    -------
    normal (8, 8), right (8,): least squares for (f0, fx, fy, b0, bx, by, f2, b2), slopes per dot
    radius; f2 and b2 are how the light bends (all directions alike), lest it pass for a slope.
    count (2,) of set [0] and clear [1] pixels, clipped (2,) of those left out because they are
    saturated or 0. taken (N, 4): the pixels, for `ring_scatter`.
    """
    height, width = image.shape
    root = a11, a12, a22 = square_root(start[2], start[3], start[4])
    det = a11 * a22 - a12 * a12
    r0 = math.sqrt(det)
    reach = outer * math.sqrt(max(a11 * a11 + a12 * a12, a12 * a12 + a22 * a22)) + 2.0 * s + 1.0
    stride = max(1, int(r0 / 6.0))
    # Of large targets there is enough to stay clear of edges that perspective may have moved.
    beside = 0.15 if r0 > 8.0 else 0.0
    nearest = 1.0 + 0.6 * (inner - 1.0)
    normal = np.zeros((8, 8))
    right = np.zeros(8)
    count, clipped = np.zeros(2), np.zeros(2)
    rows = range(max(int(start[1] - reach), 0), min(int(start[1] + reach) + 1, height), stride)
    columns = range(max(int(start[0] - reach), 0), min(int(start[0] + reach) + 1, width), stride)
    most = len(rows) * len(columns)
    taken, g, values = np.empty((most, 4)), np.empty((8, most)), np.empty(most)
    used = np.int64(0)
    for row in rows:
        for col in columns:
            dx, dy = col - start[0], row - start[1]
            u, v = (a22 * dx - a12 * dy) / det, (a11 * dy - a12 * dx) / det
            w = 1.0 - lean[0] * u - lean[1] * v
            u, v = u / w, v / w
            square = u * u + v * v
            if square < nearest * nearest or square > (outer - beside) ** 2:
                continue
            share, z_out, known = _share(u, v, root, (inner, outer), s, bits, phase, beside)
            if not known:
                continue
            if mixed < share < 1.0 - mixed or (share > 0.5 and z_out < 1.5):
                continue
            value = image[row, col] + 0.0
            if value >= saturation or value <= 0.0:
                clipped[0 if share > 0.5 else 1] += 1.0
                continue
            tx, ty = dx / r0, dy / r0
            _unknowns(share, tx, ty, g[:, used])
            values[used] = value
            taken[used, 0], taken[used, 1], taken[used, 2], taken[used, 3] = share, tx, ty, value
            used += 1
            count[0 if share > 0.5 else 1] += 1.0
    for j in range(8):
        right[j] = product(g[j], values, used)
        for k2 in range(j + 1):
            normal[j, k2] = normal[k2, j] = product(g[j], g[k2], used)
    return normal, right, count, clipped, taken[:used]


@numba.njit(cache=True, error_model="numpy")
def ring_scatter(taken, planes):
    """Return the pixels' sums of squares about the planes (8,), and their numbers.

    Index 0: set pixels of the ring; 1: clear ones.
    """
    squares, count = np.zeros(2), np.zeros(2)
    for i in range(len(taken)):
        share, tx, ty, value = taken[i, 0], taken[i, 1], taken[i, 2], taken[i, 3]
        if 0.003 < share < 0.997:
            continue
        bend = tx * tx + ty * ty - 4.0
        f = planes[0] + planes[1] * tx + planes[2] * ty + planes[6] * bend
        b = planes[3] + planes[4] * tx + planes[5] * ty + planes[7] * bend
        kind = 0 if share > 0.5 else 1
        squares[kind] += (value - b - (f - b) * share) ** 2
        count[kind] += 1.0
    return squares, count


@numba.njit(cache=True)
def planes_of(normal, right):
    """Return the solution (8,) of `ring_light`'s normal equations, and if there is one."""
    scale = np.empty(8)
    for j in range(8):
        if not normal[j, j] > 0.0:
            return scale, False
        scale[j] = 1.0 / math.sqrt(normal[j, j])
    scaled, inverse, planes = np.empty((8, 8)), np.empty((8, 8)), np.zeros(8)
    for j in range(8):
        for k in range(j + 1):
            scaled[j, k] = normal[j, k] * scale[j] * scale[k]
        scaled[j, j] += 1e-13
    solvable = invert(scaled, inverse)
    if not solvable:
        return planes, False
    for j in range(8):
        for k in range(8):
            planes[j] += inverse[j, k] * right[k] * scale[k]
        planes[j] *= scale[j]
        # How much less is known of one unknown because the others are unknown too.
        solvable = solvable and inverse[j, j] < 1e4
    return planes, solvable


_KINDS = np.array([0, 0, 0, 1, 1, 1, 0, 1])
"""Which of the unknowns of `ring_light` are of set and which of clear."""


@numba.njit(cache=True)
def slope_information(normal, variances, levels, clipped, read, gain, contrast, bend, unseen):
    """Return information (4, 4) of the slopes fx, fy, bx, by.

    Parameters
    ----------
    normal : (8, 8) from `ring_light`.
    variances, levels (2,) : of the grey values of what is set, clear.
    clipped (2,) : whether set, clear tell nothing of light.
    read, gain : variance of a grey value I is at least read + gain I.
    contrast : difference of dot and background.
    bend, unseen : standard deviation to add to slopes that are seen, by the level or the contrast;
        that of the others (2,), by the contrast.
    """
    weighted, covariance = np.empty((8, 8)), np.empty((8, 8))
    slopes, information = np.empty((4, 4)), np.zeros((4, 4))
    weights, extra = np.empty(2), np.empty(2)
    for kind in range(2):
        level = levels[kind]
        weights[kind] = 1.0 / math.sqrt(max(variances[kind], read + gain * max(level, 0.0)))
        seen = bend * max(abs(level), contrast)
        extra[kind] = unseen[kind] * contrast if clipped[kind] else seen
    for j in range(8):
        for k in range(8):
            weighted[j, k] = normal[j, k] * weights[_KINDS[j]] * weights[_KINDS[k]]
    if not invert(weighted, covariance):
        return information  # nothing is known of them
    for j in range(4):
        for k in range(4):
            # 1, 2, 4 and 5 are the slopes among all unknowns.
            slopes[j, k] = covariance[1 + j + j // 2, 1 + k + k // 2]
            if clipped[j // 2] or clipped[k // 2]:
                slopes[j, k] = 0.0
        slopes[j, j] += extra[j // 2] ** 2
    if not invert(slopes, information):
        information[:] = 0.0
    return information
