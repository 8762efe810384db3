r"""The dot's centre by weighted least squares on a blurred ellipse: at the Cramér–Rao bound.

Model of a pixel at x, with S the blurred ellipse's share of the pixel and R that of the ring:

    I(x) = B(x) + (F(x) - B(x)) (S(x) + R(x))

B and F are planes (light that falls off across dot and background), S = Φ(-d / s) with d the
distance from the ellipse and s² = blur² + 1/12 (the pixel's square). A blurred disc looks smaller
by κ s² / 2 (κ = curvature of its edge), which is taken into account. Pixels are weighted with
their variance, read² + gain · I; saturated pixels are left out by what the model expects of them,
not by what they show, so they do not pull.

The centre's covariance is that of the fit. Free slopes of F would cost up to 40 % of the accuracy
of a dot of 12 px, so they get what the ring's set and clear areas tell about them as prior
(`ring_light`), loosened by how much light may curve over the ring's width.

Any error of the model that is symmetric about the centre leaves the centre unbiased.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from omm_core.linear_algebra import invert
from omm_core.targets.reading import phi, square_root

PARAMETERS = 12
"""col, row, xx, xy, yy, s, f0, fx, fy, b0, bx, by (slopes per dot radius)."""
PIXEL_VARIANCE = 1.0 / 12.0
_ROOT2 = math.sqrt(2.0)


@numba.njit(cache=True)
def _phi(z):  # type: ignore[no-untyped-def]
    return 0.5 * math.erfc(-z / _ROOT2)


_STEPS = 32.0
_NODES = np.arange(-146, 148) / _STEPS
_PHI = np.array([0.5 * math.erfc(-z / _ROOT2) for z in _NODES])
_SLOPE = np.exp(-0.5 * _NODES**2) / math.sqrt(2.0 * math.pi)


@numba.njit(cache=True, error_model="numpy")
def _phi_and_slope(z):  # type: ignore[no-untyped-def]
    """Normal distribution (to 1e-8, a cubic between nodes) and density (to 1e-4), |z| <= 4.5."""
    t = (z - _NODES[0]) * _STEPS
    i = int(t)
    u = t - i
    rise, m0, m1 = _PHI[i + 1] - _PHI[i], _SLOPE[i] / _STEPS, _SLOPE[i + 1] / _STEPS
    share = _PHI[i] + u * (m0 + u * (3.0 * rise - 2.0 * m0 - m1 + u * (m0 + m1 - 2.0 * rise)))
    return share, _SLOPE[i] + u * (_SLOPE[i + 1] - _SLOPE[i])


@numba.njit(cache=True)
def _ring_share(u, v, rho, length, inner, s, bits, phase):  # type: ignore[no-untyped-def]
    """Share of the ring in a pixel inside of its inner edge (u, v in dot radii)."""
    n = len(bits)
    pitch = 2.0 * math.pi / n
    turn = (math.atan2(v, u) - phase) / pitch
    k = math.floor(turn + 0.5)
    before, after = bits[(k - 1) % n], bits[k % n]
    share = before
    if before != after:
        share += (after - before) * _phi((turn - k) * pitch * rho * length / s)
    return share * _phi((rho - inner) * length / s)


@numba.njit(cache=True, error_model="numpy")
def _sort_pixels(image, start, p, inner, below, pixels, flat):  # type: ignore[no-untyped-def]
    """Part the window (the dot and the gap, up to well before the ring) into edge and flat.

    Parameters
    ----------
    pixels : (3, N) out: col, row, value of the edge's pixels, and of all that may be clipped.
    flat : (2, 10) out: what the rest, wholly set [0] or wholly clear [1], tells of light: sums of
        1, tx, ty, tx², tx ty, ty², value, value tx, value ty, value².

    Returns
    -------
    Number of pixels written.
    """
    height, width = image.shape
    x0, y0, xx, xy, yy = start[0], start[1], start[2], start[3], start[4]
    a11, a12, a22 = square_root(xx, xy, yy)
    r0 = math.sqrt(a11 * a22 - a12 * a12)
    small = 0.5 * (a11 + a22 - math.sqrt((a11 - a22) ** 2 + 4.0 * a12 * a12))
    reach = 1.0 + 0.6 * (inner - 1.0)
    inside = max(1.0 - 4.2 * p[5] / small, 0.0) ** 2
    outside = (1.0 + 4.2 * p[5] / small) ** 2
    before_ring = max(inner - 4.2 * p[5] / small, 0.0) ** 2
    reach_x, reach_y = reach * math.sqrt(a11**2 + a12**2), reach * math.sqrt(a12**2 + a22**2)
    c_lo, c_hi = max(int(x0 - reach_x), 0), min(int(x0 + reach_x) + 2, width)
    r_lo, r_hi = max(int(y0 - reach_y), 0), min(int(y0 + reach_y) + 2, height)
    flat[:] = 0.0
    used = 0
    for row in range(r_lo, r_hi):
        wy, dy = row - y0, row - p[1]
        ty = wy / r0
        for col in range(c_lo, c_hi):
            wx, dx = col - x0, col - p[0]
            # The window stays where the start put it.
            if xx * wx * wx + 2.0 * xy * wx * wy + yy * wy * wy > reach * reach:
                continue
            square = p[2] * dx * dx + 2.0 * p[3] * dx * dy + p[4] * dy * dy
            value = image[row, col] + 0.0
            if inside <= square <= outside or square >= before_ring or not 0.0 < value < below:
                pixels[0, used], pixels[1, used], pixels[2, used] = col, row, value
                used += 1
                continue
            kind = 0 if square < 1.0 else 1
            tx = wx / r0
            flat[kind, 0] += 1.0
            flat[kind, 1] += tx
            flat[kind, 2] += ty
            flat[kind, 3] += tx * tx
            flat[kind, 4] += tx * ty
            flat[kind, 5] += ty * ty
            flat[kind, 6] += value
            flat[kind, 7] += value * tx
            flat[kind, 8] += value * ty
            flat[kind, 9] += value * value
    return used


@numba.njit(cache=True, fastmath=True)
def _product(a, b, count):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(count):
        total += a[i] * b[i]
    return total


# The model is evaluated in passes over all pixels: the ones without branches run in vectors.

RHO, LENGTH, DISTANCE, SHARE, SLOPE = range(5)
"""Rows of `geometry`: distance from the centre (dot radii), what that times the edge's distance is
in px, distance outside of the edge (px), share of the pixel that is set, slope of that."""


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _place(pixels, used, p, geometry):  # type: ignore[no-untyped-def]
    """Where the pixels lie with respect to the dot's edge."""
    s = p[5]
    bulge = 0.5 * s * s * (p[2] * p[4] - p[3] * p[3])
    x, y, xx, xy, yy = p[0], p[1], p[2], p[3], p[4]
    for i in range(used):
        dx, dy = pixels[0, i] - x, pixels[1, i] - y
        mx, my = xx * dx + xy * dy, xy * dx + yy * dy
        square = dx * mx + dy * my
        rho = math.sqrt(square) + 1e-12
        length = rho / (math.sqrt(mx * mx + my * my) + 1e-12)
        geometry[RHO, i], geometry[LENGTH, i] = rho, length
        geometry[DISTANCE, i] = (rho - 1.0) * length + bulge * length * length * length


@numba.njit(cache=True, error_model="numpy")
def _shares(pixels, geometry, used, p, a11, a12, a22, inner, bits, phase):  # type: ignore[no-untyped-def]
    """How much of each pixel is set."""
    s = p[5]
    area = a11 * a22 - a12 * a12
    for i in range(used):
        rho, length = geometry[RHO, i], geometry[LENGTH, i]
        z = -geometry[DISTANCE, i] / s
        if z > 4.5 or rho <= 0.3:
            share, slope = 1.0, 0.0
        elif z < -4.5:
            share, slope = 0.0, 0.0
        else:
            share, slope = _phi_and_slope(z)
        if (rho - inner) * length > -5.0 * s:
            dx, dy = pixels[0, i] - p[0], pixels[1, i] - p[1]
            u, v = (a22 * dx - a12 * dy) / area, (a11 * dy - a12 * dx) / area
            share += _ring_share(u, v, rho, length, inner, s, bits, phase)
        geometry[SHARE, i], geometry[SLOPE, i] = share, slope


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _find_clipped(pixels, geometry, used, p, x0, y0, r0, read, gain, saturation, by_value, clipped):  # type: ignore[no-untyped-def]
    """Which pixels tell "at least" (or "at most") only; whether there are any."""
    some = False
    for i in range(used):
        value, share = pixels[2, i], geometry[SHARE, i]
        tx, ty = (pixels[0, i] - x0) / r0, (pixels[1, i] - y0) / r0
        f = p[6] + p[7] * tx + p[8] * ty
        b = p[9] + p[10] * tx + p[11] * ty
        model = b + (f - b) * share
        sigma = math.sqrt(read + gain * max(model, 0.0))
        high = value > saturation - 4.5 * sigma
        clipped[i] = (model <= 0.0 and value <= 0.0) or (
            high and (by_value or model > saturation - 2.0 * sigma)
        )
        some = some or clipped[i]
    return some


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _linearise(pixels, geometry, used, p, x0, y0, r0, read, gain, clipped, rows, rests, statistics):  # type: ignore[no-untyped-def]
    """Fill weighted derivatives (12, N) and residuals (N,), 0 where clipped, and statistics."""
    x, y, xx, xy, yy = p[0], p[1], p[2], p[3], p[4]
    f0, fx, fy, b0, bx, by = p[6], p[7], p[8], p[9], p[10], p[11]
    per_s, per_r0 = 1.0 / p[5], 1.0 / r0
    set_pixels = clear_pixels = set_squares = clear_squares = chi2 = 0.0
    for i in range(used):
        dx, dy = pixels[0, i] - x, pixels[1, i] - y
        tx, ty = (pixels[0, i] - x0) * per_r0, (pixels[1, i] - y0) * per_r0
        mx, my = xx * dx + xy * dy, xy * dx + yy * dy
        per_norm = geometry[LENGTH, i] / geometry[RHO, i]
        share = geometry[SHARE, i]
        f, b = f0 + fx * tx + fy * ty, b0 + bx * tx + by * ty
        model = b + (f - b) * share
        root = 1.0 / math.sqrt(read + gain * max(model, 0.0))
        counts = 0.0 if clipped[i] else 1.0
        root *= counts
        residual = counts * (pixels[2, i] - model)
        rest = root * residual
        chi2 += rest * rest
        square = residual * residual
        set_pixels += counts if share > 0.5 else 0.0
        set_squares += square if share > 0.5 else 0.0
        clear_pixels += 0.0 if share > 0.5 else counts
        clear_squares += 0.0 if share > 0.5 else square
        steep = (f - b) * geometry[SLOPE, i] * per_s * root
        bend = -0.5 * steep * per_norm
        on, off = root * share, root * (1.0 - share)
        rows[0, i], rows[1, i] = steep * mx * per_norm, steep * my * per_norm
        rows[2, i], rows[3, i], rows[4, i] = bend * dx * dx, 2.0 * bend * dx * dy, bend * dy * dy
        rows[5, i] = steep * geometry[DISTANCE, i] * per_s
        rows[6, i], rows[7, i], rows[8, i] = on, on * tx, on * ty
        rows[9, i], rows[10, i], rows[11, i] = off, off * tx, off * ty
        rests[i] = rest
    statistics[0], statistics[1] = set_pixels, set_squares
    statistics[2], statistics[3] = clear_pixels, clear_squares
    statistics[4], statistics[5] = chi2, set_pixels + clear_pixels


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def fit_dot(
    image,
    start,
    sign,
    inner,
    bits,
    phase,
    read,
    gain,
    saturation,
    prior,
    prior_mean,
    p,
    covariance,
    statistics,
):  # type: ignore[no-untyped-def]
    """Fit the model of the module's docstring.

    Parameters
    ----------
    start : (9,) from `reading.outline`; where the slopes' coordinates begin and the window lies.
    sign : +1 bright dot, -1 dark dot.
    inner, bits, phase : the ring's inner radius (dot radii), its bits, where they begin (rad).
    read, gain : variance of a grey value I is read + gain I.
    saturation : grey value from which on a pixel tells only "at least".
    prior, prior_mean : (4, 4) information and (4,) mean of (fx, fy, bx, by).
    p : (12,) in: start values, out: solution. covariance : (2, 2) out, px².
    statistics : (6,) out: pixels and sum of squares of the dot's half, of the background's half,
        χ² and pixels in all.

    Returns
    -------
    Whether the fit converged.
    """
    x0, y0 = start[0], start[1]
    a11, a12, a22 = square_root(start[2], start[3], start[4])
    area = a11 * a22 - a12 * a12
    r0 = math.sqrt(area)
    reach = max(math.sqrt(a11 * a11 + a12 * a12), math.sqrt(a12 * a12 + a22 * a22))
    s_start = p[5]
    n = np.int64(PARAMETERS)
    f_start, b_start = p[6], p[9]
    loose = 1.0 / (f_start - b_start) ** 2
    below = saturation - 4.5 * math.sqrt(read + gain * saturation)
    converged = False
    extent = (1.0 + 0.6 * (inner - 1.0)) * reach
    most = int(2.0 * extent + 4.0) ** 2
    pixels, flat = np.empty((3, most)), np.zeros((2, 10))
    geometry = np.empty((5, most))
    rows, rests = np.empty((PARAMETERS, most)), np.empty(most)
    clipped = np.zeros(most, dtype=np.bool_)
    normal, right, inverse = np.empty((n, n)), np.empty(n), np.empty((n, n))
    scale, step = np.empty(n), np.empty(n)
    used = np.int64(0)
    sorting = True
    for turn in range(15):
        settling = turn == 0  # the centre may be right before the grey levels are
        if sorting:
            used = _sort_pixels(image, start, p, inner, below, pixels, flat)
        _place(pixels, used, p, geometry)
        _shares(pixels, geometry, used, p, a11, a12, a22, inner, bits, phase)
        if turn < 4:
            # Which pixels are clipped is settled in the first turns, lest they come and go.
            some = _find_clipped(
                pixels, geometry, used, p, x0, y0, r0, read, gain, saturation, turn < 2, clipped
            )
            settling = settling or (some and turn < 3)
        _linearise(
            pixels, geometry, used, p, x0, y0, r0, read, gain, clipped, rows, rests, statistics
        )
        for j in range(n):
            right[j] = _product(rows[j], rests, used)
            for k in range(j + 1):
                normal[j, k] = _product(rows[j], rows[k], used)
        for kind in range(2):
            # Wholly set or wholly clear: tells of light only.
            at = 6 + 3 * kind
            sums, level, slope_x, slope_y = flat[kind], p[at], p[at + 1], p[at + 2]
            w = 1.0 / (read + gain * max(level, 0.0))
            normal[at, at] += w * sums[0]
            normal[at + 1, at] += w * sums[1]
            normal[at + 2, at] += w * sums[2]
            normal[at + 1, at + 1] += w * sums[3]
            normal[at + 2, at + 1] += w * sums[4]
            normal[at + 2, at + 2] += w * sums[5]
            rest_0 = sums[6] - level * sums[0] - slope_x * sums[1] - slope_y * sums[2]
            rest_x = sums[7] - level * sums[1] - slope_x * sums[3] - slope_y * sums[4]
            rest_y = sums[8] - level * sums[2] - slope_x * sums[4] - slope_y * sums[5]
            right[at] += w * rest_0
            right[at + 1] += w * rest_x
            right[at + 2] += w * rest_y
            squares = (
                sums[9]
                - level * (sums[6] + rest_0)
                - slope_x * (sums[7] + rest_x)
                - slope_y * (sums[8] + rest_y)
            )
            statistics[2 * kind] += sums[0]
            statistics[2 * kind + 1] += squares
            statistics[4] += w * squares
            statistics[5] += sums[0]
        for j in range(4):
            a = 7 + j if j < 2 else 8 + j
            for k in range(4):
                c = 7 + k if k < 2 else 8 + k
                right[a] += prior[j, k] * (prior_mean[k] - p[c])
                if c <= a:
                    normal[a, c] += prior[j, k]
        # Where all of the dot is saturated only its edge tells of F: hold it loosely.
        normal[6, 6] += loose
        normal[9, 9] += loose
        right[6] += loose * (f_start - p[6])
        right[9] += loose * (b_start - p[9])
        for j in range(n):
            if not normal[j, j] > 0.0:
                return False
            scale[j] = 1.0 / math.sqrt(normal[j, j])
        for j in range(n):
            for k in range(j + 1):
                normal[j, k] *= scale[j] * scale[k]
        if not invert(normal, inverse):
            return False
        for j in range(n):
            step[j] = 0.0
            for k in range(n):
                step[j] += inverse[j, k] * right[k] * scale[k]
            step[j] *= scale[j]
        factor = 1.0
        move = math.sqrt(step[0] * step[0] + step[1] * step[1])
        if move > 1.0:
            factor = 1.0 / move
        if abs(step[5]) > 0.4 * p[5]:
            factor = min(factor, 0.4 * p[5] / abs(step[5]))
        level = abs(p[6] - p[9])
        for bright in (6, 9):
            if abs(step[bright]) > 0.5 * level:
                factor = min(factor, 0.5 * level / abs(step[bright]))
        if turn > 4:
            factor *= 0.5
        for j in range(n):
            p[j] += factor * step[j]
        # What is edge and what is flat is settled by the first step, unless that moves the edge by
        # so little that all that is edge has been taken for it already.
        bent = abs(step[2]) + 2.0 * abs(step[3]) + abs(step[4])
        moved = move + 0.5 * reach * reach * reach * bent + 4.2 * max(step[5], 0.0)
        sorting = turn == 0 and factor * moved > 0.2 * p[5]
        if p[5] < 0.29:
            p[5] = 0.29
        # What is saturated is at least as bright as that.
        if sign > 0.0 and f_start > below:
            p[6] = max(p[6], f_start)
        elif sign < 0.0 and b_start > below:
            p[9] = max(p[9], b_start)
        if not (p[2] > 0.0 and p[2] * p[4] > p[3] * p[3]) or p[5] > 4.0 * s_start + 2.0:
            return False
        if abs(p[0] - x0) > 0.5 * reach or abs(p[1] - y0) > 0.5 * reach:
            return False
        covariance[0, 0] = inverse[0, 0] * scale[0] * scale[0]
        covariance[0, 1] = covariance[1, 0] = inverse[0, 1] * scale[0] * scale[1]
        covariance[1, 1] = inverse[1, 1] * scale[1] * scale[1]
        if factor == 1.0 or turn > 5:
            # Below a quarter of the standard deviation; a twentieth of that step is left.
            limit = 0.03 * (covariance[0, 0] + covariance[1, 1]) + 1e-10
            if move * move < limit and not settling:
                converged = True
                # The sums are from before this step, which takes so much off χ².
                statistics[4] = max(statistics[4] - _product(step, right, n), 0.0)
                break
    return converged and sign * (p[6] - p[9]) > 0.0


@numba.njit(cache=True, error_model="numpy")
def ring_light(image, start, lean, inner, outer, bits, phase, s, saturation, mixed):  # type: ignore[no-untyped-def]
    """Planes of light F and B through what lies around the dot, ring and gap.

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
    a11, a12, a22 = square_root(start[2], start[3], start[4])
    det = a11 * a22 - a12 * a12
    r0 = math.sqrt(det)
    reach = outer * math.sqrt(max(a11 * a11 + a12 * a12, a12 * a12 + a22 * a22)) + 2.0 * s + 1.0
    stride = max(1, int(r0 / 6.0))
    # Of large targets there is enough to stay clear of edges that perspective may have moved.
    beside = 0.15 if r0 > 8.0 else 0.0
    nearest = 1.0 + 0.6 * (inner - 1.0)
    n = len(bits)
    pitch = 2.0 * math.pi / n
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
            rho = math.sqrt(square)
            if abs(rho - inner) < beside:
                continue
            # Pixels per dot radius across circles, and per radian across the sectors' borders.
            across = rho * det / math.sqrt((a22 * u - a12 * v) ** 2 + (a11 * v - a12 * u) ** 2)
            z_in, z_out = (rho - inner) * across / s, (outer - rho) * across / s
            share = 0.0
            if z_in > -3.0:
                turn = (math.atan2(v, u) - phase) / pitch
                k = math.floor(turn + 0.5)
                before, after = bits[(k - 1) % n], bits[k % n]
                share = before + 0.0
                if before != after:
                    if abs(turn - k) * pitch * rho < beside:
                        continue
                    along = math.sqrt((a11 * u + a12 * v) ** 2 + (a12 * u + a22 * v) ** 2)
                    side = square * det / along
                    share += (after - before) * phi((turn - k) * pitch * side / s)
                share *= phi(z_in) * phi(z_out)
            if mixed < share < 1.0 - mixed or (share > 0.5 and z_out < 1.5):
                continue
            value = image[row, col] + 0.0
            if value >= saturation or value <= 0.0:
                clipped[0 if share > 0.5 else 1] += 1.0
                continue
            tx, ty = dx / r0, dy / r0
            bend = tx * tx + ty * ty - 4.0
            g[0, used], g[1, used], g[2, used] = share, share * tx, share * ty
            g[3, used], g[4, used], g[5, used] = 1.0 - share, (1.0 - share) * tx, (1.0 - share) * ty
            g[6, used], g[7, used] = share * bend, (1.0 - share) * bend
            values[used] = value
            taken[used, 0], taken[used, 1], taken[used, 2], taken[used, 3] = share, tx, ty, value
            used += 1
            count[0 if share > 0.5 else 1] += 1.0
    for j in range(8):
        right[j] = _product(g[j], values, used)
        for k2 in range(j + 1):
            normal[j, k2] = normal[k2, j] = _product(g[j], g[k2], used)
    return normal, right, count, clipped, taken[:used]


@numba.njit(cache=True, error_model="numpy")
def ring_scatter(taken, planes):  # type: ignore[no-untyped-def]
    """Sums of squares about the planes (8,), and numbers, of all set [0] or clear [1] pixels."""
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
def planes_of(normal, right):  # type: ignore[no-untyped-def]
    """Solution (8,) of the normal equations of `ring_light`, and whether they can be solved."""
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
def slope_information(normal, variances, levels, clipped, read, gain, contrast, bend, unseen):  # type: ignore[no-untyped-def]
    """Information (4, 4) of the slopes fx, fy, bx, by.

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
