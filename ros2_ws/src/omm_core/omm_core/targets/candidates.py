"""Where dots may be: a scan of the rows for bright and dark runs, and an ellipse around each.

A row is followed from turning point to turning point: a run begins where the signal has risen by a
contrast threshold and ends where it has fallen by it. That needs no image-wide or windowed
threshold, so it does not mind vignetting, hot spots or bright surroundings, and costs one pass.
From the middle of a run, chords lead to the centre; rays from there to the edge give an ellipse.
What is no ellipse, or has no clear band around it, is dropped at once.

Values are multiplied by `sign` (+1: bright dots, −1: dark dots), so that dots are always high.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

RAYS = 24
_ROW_STEP = 3  # the smallest dot that is looked for covers at least two such rows
_CELL = 4  # of the map of places that were tested already, px
_MAX_ASPECT = 2.6  # axis ratio of an ellipse at 60° tilt is 2; perspective and pixels add some

# Columns of a candidate.
COL, ROW, L11, L12, L22, HIGH, LOW, SIGN = range(8)
FIELDS = 8


def find_candidates(
    image: NDArray[np.generic],
    *,
    threshold: float,
    smallest_px: float,
    largest_px: float,
    bright: bool,
    dark: bool,
) -> NDArray[np.float64]:
    """Find everything that looks like a dot with a clear band around it.

    Parameters
    ----------
    image : (height, width) uint8 or uint16
    threshold : contrast of a dot's edge, in grey values
    smallest_px, largest_px : limits of the minor and the major axis' lengths
    bright, dark : which polarities are looked for

    Returns
    -------
    (N, 8) centre (col, row), upper triangle L of the map to the unit circle
    (``|L (p - centre)| = 1`` on the edge), grey values of dot and surroundings, and the sign.
    """
    height, width = image.shape
    tested = np.zeros((2, height // _CELL + 1, width // _CELL + 1), dtype=np.bool_)
    found = np.empty((4096, FIELDS))
    count = _scan(
        image, float(threshold), smallest_px, largest_px, bright, dark, tested, found
    )  # fmt: skip
    return found[:count]


@njit(cache=True, nogil=True)
def _scan(image, threshold, smallest, largest, bright, dark, tested, found):  # type: ignore[no-untyped-def]
    height, width = image.shape
    count = 0
    for row in range(1, height - 1, _ROW_STEP):
        line = image[row]
        # Turning points: value and column of the last low, high and low (and so on by turns).
        rising = True
        low = high = float(line[0])
        before = low
        at_low = at_high = at_before = 0
        for col in range(1, width):
            value = float(line[col])
            if rising:
                if value > high:
                    high = value
                    at_high = col
                elif value < high - threshold:
                    # A dark run lies between the high before and this one, around `low`.
                    if dark and at_before < at_low and at_high - at_before < 3 * largest:
                        count = _try_run(
                            image, row, at_low, -before, -low, -high, -1, threshold,
                            smallest, largest, tested, found, count,
                        )  # fmt: skip
                    rising = False
                    before, at_before = low, at_low
                    low, at_low = value, col
            elif value < low:
                low = value
                at_low = col
            elif value > low + threshold:
                if bright and at_before < at_high and at_low - at_before < 3 * largest:
                    count = _try_run(
                        image, row, at_high, before, high, low, 1, threshold,
                        smallest, largest, tested, found, count,
                    )  # fmt: skip
                rising = True
                before, at_before = high, at_high
                high, at_high = value, col
    return count


@njit(cache=True, nogil=True)
def _try_run(  # type: ignore[no-untyped-def]
    image, row, col, before, high, after, sign, threshold, smallest, largest, tested, found, count
):
    """Look whether the run around (col, row) belongs to a dot; returns the count of found."""
    layer = 0 if sign > 0 else 1
    rise, fall = high - before, high - after
    if count == found.shape[0] or min(rise, fall) < 0.4 * max(rise, fall):
        return count
    level = high - 0.5 * min(rise, fall)
    left = _walk(image, col, row, -1, 0, sign, level, largest)
    right = _walk(image, col, row, 1, 0, sign, level, largest)
    if left < 0 or right < 0 or left + right < 0.4 * smallest or left + right > largest:
        return count
    x = int(col + 0.5 * (right - left) + 0.5)
    if tested[layer, row // _CELL, x // _CELL]:
        return count
    y = row
    for _ in range(2):
        up = _walk(image, x, y, 0, -1, sign, level, largest)
        down = _walk(image, x, y, 0, 1, sign, level, largest)
        if up < 0 or down < 0 or up + down > largest:
            return count
        y = int(y + 0.5 * (down - up) + 0.5)
        left = _walk(image, x, y, -1, 0, sign, level, largest)
        right = _walk(image, x, y, 1, 0, sign, level, largest)
        if left < 0 or right < 0 or left + right > largest:
            return count
        x = int(x + 0.5 * (right - left) + 0.5)
    if tested[layer, y // _CELL, x // _CELL]:
        return count
    tested[layer, y // _CELL, x // _CELL] = True
    wide, tall = left + right, up + down
    if max(wide, tall) < smallest or max(wide, tall) > 3.5 * min(wide, tall):
        return count
    return _try_ellipse(
        image, x, y, sign, level, 0.5 * max(wide, tall), threshold, smallest, largest, tested,
        found, count,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _walk(image, x, y, dx, dy, sign, level, limit):  # type: ignore[no-untyped-def]
    """Distance from a pixel to where the signal falls below a level; -1 where it does not."""
    height, width = image.shape
    value = sign * float(image[y, x])
    if value < level:
        return -1.0
    steps = 0
    while steps < limit:
        x += dx
        y += dy
        if x < 0 or y < 0 or x >= width or y >= height:
            return -1.0
        last = value
        value = sign * float(image[y, x])
        if value < level:
            return steps + (last - level) / (last - value)
        steps += 1
    return -1.0


@njit(cache=True, nogil=True)
def _try_ellipse(  # type: ignore[no-untyped-def]
    image, x, y, sign, level, radius, threshold, smallest, largest, tested, found, count
):
    """Cast rays, fit an ellipse, check it and its clear band; append it."""
    points = np.empty((RAYS, 2))
    for ray in range(RAYS):
        angle = 2.0 * math.pi * ray / RAYS
        distance = _cast(image, x, y, math.cos(angle), math.sin(angle), sign, level, 4.0 * radius)
        if distance < 0.0:
            return count
        points[ray, 0] = distance * math.cos(angle)
        points[ray, 1] = distance * math.sin(angle)
    shape = np.empty(5)  # centre offset (2), L11, L12, L22
    if not fit_ellipse(points, shape):
        return count
    l11, l12, l22 = shape[2], shape[3], shape[4]
    # Singular values of L are the inverse semi-axes.
    trace = l11 * l11 + l12 * l12 + l22 * l22
    root = math.sqrt(max(0.0, trace * trace - 4.0 * (l11 * l22) ** 2))
    major = 1.0 / math.sqrt(max(1e-12, 0.5 * (trace - root)))
    minor = 1.0 / math.sqrt(0.5 * (trace + root))
    if 2 * major > largest or 2 * major < smallest or major > _MAX_ASPECT * minor + 1.0:
        return count
    allowed = 0.07 + 0.45 / minor
    for ray in range(RAYS):
        u, v = points[ray, 0] - shape[0], points[ray, 1] - shape[1]
        if abs(math.hypot(l11 * u + l12 * v, l22 * v) - 1.0) > allowed:
            return count
    cx, cy = x + shape[0], y + shape[1]
    high = 0.0
    low = 0.0
    height, width = image.shape
    worst = -1e30
    for ray in range(RAYS):
        # The unit circle's direction, mapped back: p = centre + L⁻¹ q.
        angle = 2.0 * math.pi * ray / RAYS
        q1, q2 = math.cos(angle), math.sin(angle)
        v = q2 / l22
        u = (q1 - l12 * v) / l11
        inner_col, inner_row = int(cx + 0.5 * u + 0.5), int(cy + 0.5 * v + 0.5)
        outer_col, outer_row = int(cx + 1.5 * u + 0.5), int(cy + 1.5 * v + 0.5)
        if outer_col < 0 or outer_row < 0 or outer_col >= width or outer_row >= height:
            return count
        high += sign * float(image[inner_row, inner_col])
        around = sign * float(image[outer_row, outer_col])
        low += around
        worst = max(worst, around)
    high /= RAYS
    low /= RAYS
    if high - low < threshold or worst > low + 0.5 * (high - low):
        return count
    # Inside of the dot nothing needs to be tested again.
    for cell_row in range(int(cy - 0.7 * minor) // _CELL, int(cy + 0.7 * minor) // _CELL + 1):
        for cell_col in range(int(cx - 0.7 * minor) // _CELL, int(cx + 0.7 * minor) // _CELL + 1):
            tested[0 if sign > 0 else 1, cell_row, cell_col] = True
    for other in range(count):
        near = math.hypot(found[other, COL] - cx, found[other, ROW] - cy) < 0.5 * minor
        if near and found[other, SIGN] == sign:
            return count
    found[count, COL], found[count, ROW] = cx, cy
    found[count, L11], found[count, L12], found[count, L22] = l11, l12, l22
    found[count, HIGH], found[count, LOW], found[count, SIGN] = high, low, sign
    return count + 1


@njit(cache=True, nogil=True)
def _cast(image, x, y, dx, dy, sign, level, limit):  # type: ignore[no-untyped-def]
    """Distance from a pixel's centre along a direction to where the signal falls below a level."""
    height, width = image.shape
    last = sign * float(image[y, x])
    distance = 0.0
    while distance < limit:
        distance += 1.0
        u, v = x + distance * dx, y + distance * dy
        i, j = int(math.floor(u)), int(math.floor(v))
        if i < 0 or j < 0 or i >= width - 1 or j >= height - 1:
            return -1.0
        fu, fv = u - i, v - j
        value = sign * (
            (1.0 - fv) * ((1.0 - fu) * image[j, i] + fu * image[j, i + 1])
            + fv * ((1.0 - fu) * image[j + 1, i] + fu * image[j + 1, i + 1])
        )
        if value < level:
            return distance - (level - value) / max(1e-9, last - value)
        last = value
    return -1.0


@njit(cache=True, nogil=True)
def fit_ellipse(points, shape):  # type: ignore[no-untyped-def]
    """Least-squares conic ``a x² + b xy + c y² + d x + e y = 1`` around the origin.

    Parameters
    ----------
    points : (N, 2)
    shape : (5,), filled with centre offset and L (see `find_candidates`)

    Returns
    -------
    Whether it is an ellipse.
    """
    scale = 0.0
    for point in points:
        scale = max(scale, abs(point[0]), abs(point[1]))
    if scale <= 0.0:
        return False
    normal, right = np.zeros((5, 5)), np.zeros(5)
    for point in points:
        u, v = point[0] / scale, point[1] / scale
        terms = (u * u, u * v, v * v, u, v)
        for i in range(5):
            right[i] += terms[i]
            for j in range(5):
                normal[i, j] += terms[i] * terms[j]
    for i in range(5):
        normal[i, i] += 1e-12
    a, b, c, d, e = np.linalg.solve(normal, right)
    determinant = 4.0 * a * c - b * b
    if a <= 0.0 or c <= 0.0 or determinant <= 0.0:
        return False
    u0 = (b * e - 2.0 * c * d) / determinant
    v0 = (b * d - 2.0 * a * e) / determinant
    size = 1.0 + a * u0 * u0 + b * u0 * v0 + c * v0 * v0
    if size <= 0.0:
        return False
    m11, m12, m22 = a / size, 0.5 * b / size, c / size
    l11 = math.sqrt(m11)
    l12 = m12 / l11
    rest = m22 - l12 * l12
    if rest <= 0.0:
        return False
    shape[0], shape[1] = u0 * scale, v0 * scale
    shape[2], shape[3], shape[4] = l11 / scale, l12 / scale, math.sqrt(rest) / scale
    return True
