"""Reading the ring: the sectors' light against what a code would look like through the blur.

The ring is sampled on three circles between its radii. A code is taken only if the whole profile
looks like that code, blurred as the dot's edge is, seen under even light: bits that are read one
by one would take anything for a code.
"""

import math

import numpy as np
from numba import njit

SAMPLES = 12  # around a sector
_RADII = 3

# What came out, see `read_ring`.
READ, UNEVEN, NOT_CLEAR, UNLIKE, AMBIGUOUS, OUTSIDE = range(6)


@njit(cache=True, nogil=True)
def _bilinear(image, u, v):  # type: ignore[no-untyped-def]
    i, j = int(math.floor(u)), int(math.floor(v))
    fu, fv = u - i, v - j
    return (1.0 - fv) * ((1.0 - fu) * image[j, i] + fu * image[j, i + 1]) + fv * (
        (1.0 - fu) * image[j + 1, i] + fu * image[j + 1, i + 1]
    )


@njit(cache=True, nogil=True)
def _circle(image, cx, cy, l11, l12, l22, rho, sign, values):  # type: ignore[no-untyped-def]
    """Sample a circle of radius rho around the dot; False where it leaves the image."""
    height, width = image.shape
    n = len(values)
    for k in range(n):
        angle = 2.0 * math.pi * (k + 0.5) / n
        v = rho * math.sin(angle) / l22
        u = (rho * math.cos(angle) - l12 * v) / l11
        col, row = cx + u, cy + v
        if col < 0 or row < 0 or col >= width - 1 or row >= height - 1:
            return False
        values[k] = sign * _bilinear(image, col, row)
    return True


@njit(cache=True, nogil=True)
def read_ring(  # type: ignore[no-untyped-def]
    image, cx, cy, l11, l12, l22, sign, high, low, sigma, inner, outer, bits, sectors, figures
):
    """Read the sectors of a ring.

    Parameters
    ----------
    sectors : (bits,) filled with 0 and 1, clockwise
    figures : (4,) filled with the angle where the first sector begins (radians, in the plane of
        the unit circle), the profile's misfit, the next best misfit, and the ring's gain

    Returns
    -------
    READ, or why not.
    """
    n = bits * SAMPLES
    profile, gap, values = np.zeros(n), np.zeros(n), np.zeros(n)
    contrast = high - low
    if not _circle(image, cx, cy, l11, l12, l22, 0.5 * (1.0 + inner), sign, gap):
        return OUTSIDE
    radius = 1.0 / math.sqrt(l11 * l22)
    leak = 0.5 * math.erfc(0.5 * (inner - 1.0) * radius / (sigma * 1.4142135623730951))
    for k in range(n):
        if (gap[k] - low) / contrast > 0.25 + 2.0 * leak:
            return NOT_CLEAR
    for circle in range(_RADII):
        rho = inner + (outer - inner) * (0.32 + 0.18 * circle)
        if not _circle(image, cx, cy, l11, l12, l22, rho, sign, values):
            return OUTSIDE
        for k in range(n):
            profile[k] += (values[k] - low) / (contrast * _RADII)
    smallest, largest = profile[0], profile[0]
    for k in range(n):
        smallest, largest = min(smallest, profile[k]), max(largest, profile[k])
    if largest - smallest < 0.3 or largest < 0.4 or smallest > 0.6:
        return UNEVEN
    middle = 0.5 * (inner + outer)
    kernel = _blur_kernel(sigma / (middle * radius), n)
    best = np.zeros(bits, dtype=np.int64)
    trial = np.zeros(bits, dtype=np.int64)
    best_misfit, best_phase, gain = 1e9, 0, 1.0
    for phase in range(SAMPLES):
        _threshold(profile, phase, 0.5 * (smallest + largest), trial)
        misfit, scale = _misfit(profile, phase, trial, kernel)
        if misfit < best_misfit:
            best_misfit, best_phase, gain = misfit, phase, scale
            best[:] = trial
    # Blur may have drowned a sector between two others: single flips that fit better are taken.
    next_misfit = 1e9
    improved = True
    while improved:
        improved = False
        next_misfit = 1e9
        for flip in range(bits):
            trial[:] = best
            trial[flip] = 1 - trial[flip]
            misfit, scale = _misfit(profile, best_phase, trial, kernel)
            if misfit < best_misfit:
                next_misfit = best_misfit
                best_misfit, gain = misfit, scale
                best[:] = trial
                improved = True
                break
            next_misfit = min(next_misfit, misfit)
    sectors[:] = best
    figures[0] = 2.0 * math.pi * best_phase / n
    figures[1], figures[2], figures[3] = math.sqrt(best_misfit), math.sqrt(next_misfit), gain
    if figures[1] > 0.17 or gain < 0.4 or gain > 1.7:
        return UNLIKE
    if figures[2] < 1.5 * figures[1] or figures[2] - figures[1] < 0.03:
        return AMBIGUOUS
    return READ


@njit(cache=True, nogil=True)
def _blur_kernel(sigma_rad, n):  # type: ignore[no-untyped-def]
    """Gaussian on the circle's samples."""
    step = 2.0 * math.pi / n
    reach = min(n // 2 - 1, int(3.0 * sigma_rad / step) + 1)
    kernel = np.zeros(2 * reach + 1)
    for k in range(-reach, reach + 1):
        kernel[k + reach] = math.exp(-0.5 * (k * step / max(sigma_rad, 1e-6)) ** 2)
    return kernel / kernel.sum()


@njit(cache=True, nogil=True)
def _threshold(profile, phase, level, sectors):  # type: ignore[no-untyped-def]
    """Bits from the middle half of each sector."""
    n = len(profile)
    for bit in range(len(sectors)):
        total = 0.0
        for k in range(SAMPLES // 4, SAMPLES - SAMPLES // 4):
            total += profile[(phase + bit * SAMPLES + k) % n]
        sectors[bit] = 1 if total / (SAMPLES // 2) > level else 0


@njit(cache=True, nogil=True)
def _misfit(profile, phase, sectors, kernel):  # type: ignore[no-untyped-def]
    """Mean squared difference of a profile from a code's, with gain and offset fitted; the gain."""
    n = len(profile)
    reach = len(kernel) // 2
    expected = np.zeros(n)
    for k in range(n):
        total = 0.0
        for j in range(-reach, reach + 1):
            total += kernel[j + reach] * sectors[((k - phase + j) % n) // SAMPLES]
        expected[k] = total
    mean_e, mean_p = expected.mean(), profile.mean()
    see = sep = spp = 0.0
    for k in range(n):
        e, p = expected[k] - mean_e, profile[k] - mean_p
        see += e * e
        sep += e * p
        spp += p * p
    if see < 1e-9:
        return spp / n, 1.0
    gain = sep / see
    return max(0.0, spp - gain * sep) / n, gain
