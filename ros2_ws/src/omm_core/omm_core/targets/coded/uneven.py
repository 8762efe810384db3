"""Rings on which the light falls off: a reflector's beam ends there, or a shadow begins.

A retroreflective target sends the light back to where it came from, so a lamp beside the lens
leaves one side of it darker. Light is taken to fall exponentially along one direction,

    l(θ) = exp(a + b cos θ + c sin θ)    (θ clockwise around the ring, 1 is the dot's level),

fitted to the sectors that are set under it, until these do not change any more.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.targets.coded.reading import SAMPLES, read_bits, ring_profile
from omm_core.targets.conic.outline import square_root

Floats = NDArray[np.float64]

MAX_FALL = 1.6
"""Largest amplitude of the logarithm: e^3.2, 25 times, from the darkest to the brightest side."""
MIN_FALL = 0.08
"""What falls less is evenly lit: then something else was against the ring."""
MAX_SIDES = 1.6
"""Largest ratio of the ring's brightness near its two edges (blur takes from both)."""
MIN_SET = 3
"""Three unknowns need three sectors."""
_TURNS = 10
_SIGMA_LEVEL, _SIGMA_SLOPE = 0.3, 0.5
"""How far (of the logarithm) the ring's level is from the dot's, and its slope from the dot's own
slope, extrapolated: weak knowledge that keeps few sectors from telling everything."""
_FAINT = 0.02
_STARTS = (0.4, 0.2, 0.1, 0.05)
"""Shares of the brightest sector from which on one counts as set at the beginning."""


def lights_across(
    image: NDArray[Any], shape: Floats, inner: float, outer: float, bits: int
) -> list[Floats]:
    """Fit the fall of light around a ring that could not be read as evenly lit.

    Which sectors are set decides the fall, and the fall which are set: it is begun in several ways,
    and what does not settle is left out.

    Parameters
    ----------
    shape : (9,) from `outline.outline`.
    inner, outer, bits : the family's ring: radii (dot radii) and number of sectors.

    Returns
    -------
    (3,) a, b, c of the module's docstring each; none where it cannot be told.
    """
    count = bits * SAMPLES
    a11, a12, a22 = square_root(shape[2], shape[3], shape[4])
    base, height = float(shape[6]), float(shape[5] - shape[6])
    middle, spread = 0.5 * (inner + outer), 0.25 * (outer - inner)

    def profile(radii: Floats) -> Floats:
        seen = ring_profile(
            image, shape[0], shape[1], a11, a12, a22, 0.0, 0.0, np.asarray(radii), count
        )
        return np.asarray((seen - base) / height)

    ring = profile(np.array([middle - spread, middle, middle + spread]))
    sides = [profile(np.array([radius])) for radius in (middle - spread, middle + spread)]
    dot = profile(np.array([0.35, 0.6]))
    if not (np.isfinite(ring).all() and dot.min() > _FAINT):
        return []
    angles = 2.0 * math.pi * (np.arange(count) + 0.5) / count
    # The dot's own slope, carried on to the ring's radius.
    rows = np.column_stack([np.ones(count), np.cos(angles), np.sin(angles)])
    inside = np.linalg.lstsq(rows, np.log(dot), rcond=None)[0]
    mean = np.array([inside[0], *(inside[1:] * middle / 0.475)])
    values, phase = read_bits(ring, bits)
    centres = 2.0 * math.pi * (phase / count + (np.arange(bits) + 0.5) / bits)
    at = np.column_stack([np.ones(bits), np.cos(centres), np.sin(centres)])
    weight = np.diag([_SIGMA_LEVEL, _SIGMA_SLOPE, _SIGMA_SLOPE]) ** 2
    brightest = float(values.max())
    starts = [values > 0.5 * np.exp(at @ mean)]
    starts += [values > share * brightest for share in _STARTS]
    found: list[Floats] = []
    for chosen in starts:
        light = _settled(values, chosen, at, mean, weight)
        if light is None or any(np.allclose(light, other) for other in found):
            continue
        if math.hypot(light[1], light[2]) >= MIN_FALL and _fills(sides, ring, light, angles):
            found.append(light)
    return found


def _fills(sides: list[Floats], ring: Floats, light: Floats, angles: Floats) -> bool:
    """Return whether what is set is as bright near the ring's inner edge as near its outer one.

    Another family's ring, of which only a part lies here, is not.
    """
    expected = np.exp(light[0] + light[1] * np.cos(angles) + light[2] * np.sin(angles))
    chosen = ring > 0.5 * expected
    inside, outside = (float(np.sum(side[chosen])) for side in sides)
    return inside > 0.0 and 1.0 / MAX_SIDES < outside / inside < MAX_SIDES


def _settled(
    values: Floats, chosen: NDArray[np.bool_], at: Floats, mean: Floats, weight: Floats
) -> Floats | None:
    """Fit light and the choice of set sectors in turn."""
    for _ in range(_TURNS):
        if chosen.sum() < MIN_SET or chosen.all():
            return None
        rest = np.log(np.maximum(values[chosen], _FAINT)) - at[chosen] @ mean
        gain = weight @ at[chosen].T
        noise = 0.05**2 * np.eye(int(chosen.sum()))
        light = np.asarray(mean + gain @ np.linalg.solve(at[chosen] @ gain + noise, rest))
        if math.hypot(light[1], light[2]) > MAX_FALL:
            return None
        before, chosen = chosen, values > 0.5 * np.exp(at @ light)
        if np.array_equal(chosen, before):
            return light
    return None
