"""The centre of a dot: least squares of a blurred elliptical disc under uneven light.

    I(p) = D(p) + b + (W(p) - D(p)) (1 + c) Φ(d(p) / σ)

D and W are the light on the dark and on the bright film as it varies over the target, d the
distance to the ellipse's edge (positive inside), Φ the normal distribution, σ the blur. Unknown are
the ellipse (5), σ, b and c. With white noise of the variance that each pixel has, this reaches the
Cramér-Rao bound; a threshold, a centroid or a contour loses 20 to 100 % (docs/targets.md).

Two effects bias every method that does not model them:

- Light that falls off across the dot moves the fitted edge, 0.01 px and more. D and W are surfaces
  fitted beforehand, from pixels that no edge reaches. Within the dot alone, a slope can hardly be
  told from a shift (for a dot of 20 px the centre's variance would grow by 40 %), so W also takes
  the bright sectors of the ring: at 2.5 radii, a slope shows 30 times as well.
- Saturated pixels say only "at least": they are left out, which is symmetric about the centre.

The covariance is that of the adjustment, with the noise seen in this very target, and the slopes'
own uncertainty. Where the residuals are not noise (a scratch, a reflection on the edge), they
agree along the edge: the covariance clustered by sectors of the edge then takes over, and the
worst sector is reported.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

SECTORS = 16
_ITERATIONS = 12
_SAFE_SIGMA = 2.8  # pixels this many blurs away from every edge see none of it
_BAND_SIGMA = 3.5  # pixels further than this from the edge tell nothing about it
_SLOPE_PRIOR = 0.03  # relative change of the light over a dot's radius, standard deviation
_MAX_SAMPLES = 700  # of each surface; more would not make it better noticeably

# Columns of a fitted dot.
(
    COL, ROW, L11, L12, L22, SIGMA, HIGH, LOW,
    VAR_COL, COVAR, VAR_ROW, NOISE_HIGH, NOISE_LOW, MISFIT, WORST_SECTOR, WORST_VALUE, SATURATED,
) = range(17)  # fmt: skip
FIELDS = 17
OK, NO_CONVERGENCE, NO_SURROUNDINGS, OUTSIDE = 0, 1, 2, 3


@njit(cache=True, nogil=True)
def distance_scale(q1, q2, rho, l11, l12, l22):  # type: ignore[no-untyped-def]
    """Pixels per unit of ``rho`` along its gradient: turns ``1 - rho`` into a distance."""
    g1 = q1 * l11
    g2 = q1 * l12 + q2 * l22
    return rho / max(1e-12, math.sqrt(g1 * g1 + g2 * g2))


@njit(cache=True, nogil=True)
def fit_dot(  # type: ignore[no-untyped-def]
    image, start, sign, sigma0, saturation, ring_inner, ring_outer, sectors, ring_angle, dot
):
    """Fit one dot.

    Parameters
    ----------
    image : (H, W)
    start : (7,) centre, L (3), high, low in signed values
    sign : +1 or -1
    sigma0 : first guess of the blur, px
    saturation : signed grey value from which on a pixel is saturated (bright dots), or inf
    ring_inner, ring_outer : radii of the ring in dot radii
    sectors : (n,) 1 where set, 0 where clear, -1 where not known yet
    ring_angle : where the first sector begins, radians in the unit circle's plane
    dot : (17,), filled

    Returns
    -------
    OK or why not.
    """
    height, width = image.shape
    cx, cy = start[0], start[1]
    l11, l12, l22 = start[2], start[3], start[4]
    sigma = sigma0
    white, black = np.zeros(4), np.zeros(4)
    white_cov, black_cov = np.zeros((4, 4)), np.zeros((4, 4))
    radius = 1.0 / math.sqrt(l11 * l22)
    noise = np.zeros(2)
    ok = _surfaces(
        image, cx, cy, l11, l12, l22, sign, sigma, saturation, start[5], start[6], ring_inner,
        ring_outer, sectors, ring_angle, white, white_cov, black, black_cov, noise,
    )  # fmt: skip
    if not ok:
        return NO_SURROUNDINGS
    x0, y0 = cx, cy  # the surfaces are centred here
    b = c = 0.0
    contrast = max(1.0, white[0] - black[0])
    prior_b = 1.0 / max(1e-3, black_cov[0, 0])
    prior_c = contrast * contrast / max(1e-3, white_cov[0, 0])
    H, g, step = np.zeros((8, 8)), np.zeros(8), np.zeros(8)
    cross = np.zeros((8, 4))
    by_sector = np.zeros((SECTORS, 8))
    sums, counts = np.zeros(SECTORS), np.zeros(SECTORS)
    J, slopes = np.zeros(8), np.zeros(4)
    converged = False
    misfit = 0.0
    saturated = 0
    last = False
    settled_sigma = sigma
    for iteration in range(_ITERATIONS + 1):
        H[:] = 0.0
        g[:] = 0.0
        by_sector[:] = 0.0
        cross[:] = 0.0
        sums[:] = 0.0
        counts[:] = 0.0
        misfit = 0.0
        saturated = 0
        n = 0
        # Which pixels count must settle, or the iterations swing between two sets of them.
        if iteration < 4:
            settled_sigma = sigma
        band = _BAND_SIGMA * settled_sigma + 0.5
        # Half the box that holds the ellipse: |L⁻¹| along both axes.
        half_y = 1.0 / l22 + band
        half_x = math.sqrt(1.0 + (l12 / l22) ** 2) / l11 + band
        first_row, last_row = int(cy - half_y), int(cy + half_y) + 1
        first_col, last_col = int(cx - half_x), int(cx + half_x) + 1
        if first_row < 0 or first_col < 0 or last_row >= height or last_col >= width:
            return OUTSIDE
        # Bounds of rho that hold the band everywhere: most pixels are dropped by one comparison.
        steepest = math.sqrt(l11 * l11 + l12 * l12 + l22 * l22)
        least = max(1e-3, 1.0 - band * steepest) ** 2
        most = (1.0 + band * steepest) ** 2
        for row in range(first_row, last_row + 1):
            dy = row - cy
            for col in range(first_col, last_col + 1):
                dx = col - cx
                q1, q2 = l11 * dx + l12 * dy, l22 * dy
                rho2 = q1 * q1 + q2 * q2
                if rho2 < least or rho2 > most:
                    continue
                rho = math.sqrt(rho2)
                scale = distance_scale(q1, q2, rho, l11, l12, l22)
                d = (1.0 - rho) * scale
                if d > band or d < -band:
                    continue
                if (ring_inner - rho) * scale < 2.0 * settled_sigma:
                    continue  # the ring's own edge shines in here
                value = sign * float(image[row, col])
                if value >= saturation:
                    saturated += 1
                    continue
                ex, ey = (col - x0) / radius, (row - y0) / radius
                e2 = ex * ex + ey * ey
                W = white[0] + white[1] * ex + white[2] * ey + white[3] * e2
                D = black[0] + black[1] * ex + black[2] * ey + black[3] * e2
                S = 0.5 * math.erfc(-d / (sigma * 1.4142135623730951))
                density = math.exp(-0.5 * (d / sigma) ** 2) / (sigma * 2.5066282746310002)
                amplitude = (W - D) * (1.0 + c)
                model = D + b + amplitude * S
                if model > saturation:
                    continue
                variance = max(1e-3, noise[1] + (noise[0] - noise[1]) * S)
                weight = 1.0 / variance
                r = value - model
                k = amplitude * density * scale / rho
                J[0] = k * q1 * l11
                J[1] = k * (q1 * l12 + q2 * l22)
                J[2] = -k * q1 * dx
                J[3] = -k * q1 * dy
                J[4] = -k * q2 * dy
                J[5] = -amplitude * density * d / sigma
                J[6] = 1.0
                J[7] = (W - D) * S
                for i in range(8):
                    wi = weight * J[i]
                    g[i] += wi * r
                    for j in range(i, 8):
                        H[i, j] += wi * J[j]
                if last:
                    slopes[0], slopes[1] = ex * S, ey * S
                    slopes[2], slopes[3] = ex * (1.0 - S), ey * (1.0 - S)
                    sector = int((math.atan2(q2, q1) / (2.0 * math.pi) + 1.0) * SECTORS) % SECTORS
                    for i in range(8):
                        by_sector[sector, i] += weight * J[i] * r
                        for j in range(4):
                            cross[i, j] += weight * J[i] * slopes[j]
                    sums[sector] += r
                    counts[sector] += 1.0
                misfit += weight * r * r
                n += 1
        if n < 12:
            return NO_CONVERGENCE
        g[6] -= prior_b * b
        g[7] -= prior_c * c
        H[6, 6] += prior_b
        H[7, 7] += prior_c
        for i in range(8):
            for j in range(i):
                H[i, j] = H[j, i]
            H[i, i] *= 1.0 + 1e-9
            if H[i, i] <= 0.0:
                return NO_CONVERGENCE
        misfit /= max(1.0, n - 8.0)
        if last:
            break
        step[:] = np.linalg.solve(H, g)
        # A blur that changes its sign or by a factor would leave where the model is linear.
        change = max(-0.4 * sigma, min(0.6 * sigma, step[5]))
        if abs(step[0]) > 0.5 * radius or abs(step[1]) > 0.5 * radius:
            return NO_CONVERGENCE
        cx += step[0]
        cy += step[1]
        l11 += step[2]
        l12 += step[3]
        l22 += step[4]
        sigma += change
        b += step[6]
        c += step[7]
        if sigma < 0.2:
            sigma = 0.2
        if l11 <= 0.0 or l22 <= 0.0 or sigma > radius or not math.isfinite(cx + cy):
            return NO_CONVERGENCE
        moved = abs(step[0]) + abs(step[1])
        if moved < 1e-4 and abs(change) < 2e-3 * sigma:
            converged = True
            last = True
        elif iteration == _ITERATIONS - 1:
            last = True
    if not converged:
        return NO_CONVERGENCE
    _finish(
        H, cross, white_cov, black_cov, by_sector, sums, counts, amplitude_of(white, black, c),
        noise, misfit, dot,
    )  # fmt: skip
    dot[COL], dot[ROW], dot[L11], dot[L12], dot[L22], dot[SIGMA] = cx, cy, l11, l12, l22, sigma
    dot[LOW] = black[0] + b
    dot[HIGH] = dot[LOW] + amplitude_of(white, black, c)
    dot[NOISE_HIGH], dot[NOISE_LOW] = noise[0], noise[1]
    dot[SATURATED] = saturated
    return OK


@njit(cache=True, nogil=True)
def amplitude_of(white, black, c):  # type: ignore[no-untyped-def]
    """Contrast at the centre."""
    return (white[0] - black[0]) * (1.0 + c)


@njit(cache=True, nogil=True)
def _finish(  # type: ignore[no-untyped-def]
    H, cross, white_cov, black_cov, by_sector, sums, counts, amplitude, noise, misfit, dot
):
    """Covariance of the centre: of the adjustment, of the slopes, or clustered by sectors."""
    inverse = np.linalg.inv(H)
    by_slopes = inverse @ cross
    slope_cov = np.zeros((4, 4))
    for i in range(2):
        for j in range(2):
            slope_cov[i, j] = white_cov[1 + i, 1 + j]
            slope_cov[2 + i, 2 + j] = black_cov[1 + i, 1 + j]
    total = inverse + by_slopes @ slope_cov @ by_slopes.T
    scores = by_sector @ inverse
    clustered = np.zeros((2, 2))
    for s in range(SECTORS):
        for i in range(2):
            for j in range(2):
                clustered[i, j] += scores[s, i] * scores[s, j]
    dot[MISFIT] = misfit
    mean_noise = 0.5 * (noise[0] + noise[1])
    worst, worst_value, disturbed = -1, 0.0, 0.0
    for s in range(SECTORS):
        if counts[s] > 0:
            mean = sums[s] / counts[s]
            z = abs(mean) * math.sqrt(counts[s] / max(1e-3, mean_noise))
            if abs(mean) > abs(worst_value):
                worst, worst_value = s, mean
            disturbed = max(disturbed, z)
    dot[WORST_SECTOR] = worst
    dot[WORST_VALUE] = worst_value / max(1.0, amplitude)
    # Residuals that agree along the edge are no noise: believe what they did to the centre.
    if disturbed > 6.0 and clustered[0, 0] + clustered[1, 1] > total[0, 0] + total[1, 1]:
        for i in range(2):
            for j in range(2):
                total[i, j] = clustered[i, j] + total[i, j]
    inflate = max(1.0, misfit) if misfit > 1.3 else 1.0
    dot[VAR_COL], dot[COVAR], dot[VAR_ROW] = (
        inflate * total[0, 0], inflate * total[0, 1], inflate * total[1, 1],
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _surfaces(  # type: ignore[no-untyped-def]
    image, cx, cy, l11, l12, l22, sign, sigma, saturation, high, low, ring_inner, ring_outer,
    sectors, ring_angle, white, white_cov, black, black_cov, noise,
):  # fmt: skip
    """Fit the light on bright and dark film: value, slopes (per radius) and curvature."""
    height, width = image.shape
    radius = 1.0 / math.sqrt(l11 * l22)
    n = len(sectors)
    known = sectors[0] >= 0
    reach = ring_outer if known else ring_inner
    half_y = reach / l22
    half_x = reach * math.sqrt(1.0 + (l12 / l22) ** 2) / l11
    area = 4.0 * half_x * half_y
    stride = max(1, int(math.sqrt(area / (2.5 * _MAX_SAMPLES))))
    normals = np.zeros((2, 4, 4))
    rights = np.zeros((2, 4))
    squares, counts = np.zeros(2), np.zeros(2)
    safe = _SAFE_SIGMA * sigma + 0.4
    terms = np.zeros(4)
    saturated = 0
    for row in range(max(0, int(cy - half_y)), min(height - 1, int(cy + half_y)) + 1, stride):
        dy = row - cy
        for col in range(max(0, int(cx - half_x)), min(width - 1, int(cx + half_x)) + 1, stride):
            dx = col - cx
            q1, q2 = l11 * dx + l12 * dy, l22 * dy
            rho = math.sqrt(q1 * q1 + q2 * q2)
            if rho > reach:
                continue
            scale = distance_scale(q1, q2, max(rho, 1e-9), l11, l12, l22)
            if rho < 1.0:
                kind = 0
                margin = (1.0 - rho) * scale
            elif rho < ring_inner:
                kind = 1
                end = ring_inner if known else 0.92 * ring_inner
                margin = min(rho - 1.0, end - rho) * scale
            else:
                margin = min(rho - ring_inner, ring_outer - rho) * scale
                turn = (math.atan2(q2, q1) - ring_angle) / (2.0 * math.pi) * n
                turn -= math.floor(turn / n) * n
                sector = int(turn) % n
                kind = 0 if sectors[sector] == 1 else 1
                within = turn - math.floor(turn)
                arc = 2.0 * math.pi / n * rho * scale
                if sectors[(sector - 1) % n] != sectors[sector]:
                    margin = min(margin, within * arc)
                if sectors[(sector + 1) % n] != sectors[sector]:
                    margin = min(margin, (1.0 - within) * arc)
                margin -= 0.12 * rho * scale * 0.5  # the ring lies less surely than the dot
            if margin < safe:
                continue
            value = sign * float(image[row, col])
            if value >= saturation:
                saturated += 1
                continue
            ex, ey = dx / radius, dy / radius
            terms[0], terms[1], terms[2], terms[3] = 1.0, ex, ey, ex * ex + ey * ey
            base = high if kind == 0 else low
            for i in range(4):
                rights[kind, i] += terms[i] * (value - base)
                for j in range(4):
                    normals[kind, i, j] += terms[i] * terms[j]
            squares[kind] += (value - base) ** 2
            counts[kind] += 1.0
    contrast = max(1.0, high - low)
    if counts[1] < 6:
        counts[1] = 0.0
    for kind in range(2):
        base = high if kind == 0 else low
        surface = white if kind == 0 else black
        covariance = white_cov if kind == 0 else black_cov
        variance = max(0.5, squares[kind] / max(1.0, counts[kind]))
        for _ in range(2):
            normal = normals[kind] / variance
            normal[0, 0] += 1.0 / (0.5 * contrast) ** 2
            for i in range(1, 4):
                normal[i, i] += 1.0 / (_SLOPE_PRIOR * contrast) ** 2
            inverse = np.linalg.inv(normal)
            solution = inverse @ (rights[kind] / variance)
            rest = (
                squares[kind] - 2.0 * (solution @ rights[kind])
                + solution @ (normals[kind] @ solution)
            )  # fmt: skip
            if counts[kind] > 8:
                variance = max(0.08, rest / (counts[kind] - 4.0))
            else:
                variance = max(1.0, (0.02 * contrast) ** 2)
        noise[kind] = variance
        for i in range(4):
            surface[i] = solution[i]
            for j in range(4):
                covariance[i, j] = inverse[i, j]
        surface[0] += base
    if counts[0] <= 8:  # small or saturated: the surroundings' noise is the best guess
        noise[0] = max(noise[0], noise[1]) if saturated == 0 else noise[1]
        if saturated > 0:
            white[0] = max(white[0], saturation)
    return white[0] - black[0] > 0.3 * contrast
