"""Light around each dot, from the set and clear areas of its ring; and the camera's noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.targets.coded.families import TargetFamily
from omm_core.targets.coded.judging import RingReading
from omm_core.targets.coded.light_kernels import (
    planes_of,
    ring_light,
    ring_scatter,
    slope_information,
)

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Light:
    """Planes of light F (set) and B (clear) around a dot, slopes per dot radius.

    Attributes
    ----------
    levels, variances, pixels : (2,) of set and clear.
    slopes : (4,) fx, fy, bx, by.
    clipped : (2,) whether pixels are saturated (or 0), so that set or clear tell nothing of light.
    normal : (8, 8) normal matrix of `light_kernels.ring_light`, for a variance of 1.
    """

    levels: Floats
    variances: Floats
    pixels: Floats
    slopes: Floats
    normal: Floats
    clipped: NDArray[np.bool_]


UNSEEN_SLOPE_SATURATED, UNSEEN_SLOPE_BLACK = 5e-4, 3e-3
"""Fall of light per dot radius (standard deviation, of the contrast) taken where it is clipped.
Zeros come from processing (a black level cut away, sharpening) that does more to the edges."""
_UNSEEN = np.array([UNSEEN_SLOPE_SATURATED, UNSEEN_SLOPE_BLACK])
_SLOPES = np.array([1, 2, 4, 5])
Mixed = tuple[tuple[float, int], ...]
MIXED: Mixed = ((0.01, 12), (0.12, 0))
MIXED_ONCE_FITTED: Mixed = ((0.02, 45), (0.12, 60), (0.4, 0))
"""Share of set in a clear pixel, or of clear in a set one, up to which it tells of light, and how
many such pixels must be there, or else the next share is taken: before the dot is fitted (with the
second share a dot of 12 px is then off by 0.002 px), and when outline and blur are known."""


def light_around(
    image: NDArray[Any],
    family: TargetFamily,
    reading: RingReading,
    saturation: float,
    mixed: Mixed = MIXED,
) -> Light | None:
    """Return the light around the dot, or None where too little of the ring can be used.

    Parameters
    ----------
    mixed : `MIXED` or `MIXED_ONCE_FITTED`.
    """
    s = max(float(reading.outline[8]), 0.35)
    for share, enough in mixed:
        normal, right, count, clipped, taken = ring_light(
            image,
            reading.outline,
            reading.lean,
            family.ring_inner_ratio,
            family.ring_outer_ratio,
            reading.bits,
            reading.phase_rad,
            s,
            saturation,
            share,
        )
        if count.min() >= enough:
            break
    lost = clipped > 0.02 * count
    if lost.any():
        return _half_clipped(taken, lost)
    planes, solvable = planes_of(normal, right)
    if count.min() < 6 or not solvable:
        return None
    squares, count = ring_scatter(taken, planes)
    pixels = np.maximum(count - 3.0, 0.0)
    return Light(
        levels=planes[[0, 3]],
        variances=np.maximum(squares / np.maximum(pixels, 1.0), 1.0 / 12.0),
        pixels=pixels,
        slopes=planes[_SLOPES],
        normal=normal,
        clipped=lost,
    )


def _half_clipped(taken: Floats, lost: NDArray[np.bool_]) -> Light:
    """Return the light where set or clear is clipped: the other's plane, far from edges."""
    levels, variances, pixels = np.zeros(2), np.full(2, 1.0 / 12.0), np.zeros(2)
    slopes, normal = np.zeros(4), np.eye(8)
    for kind in np.flatnonzero(~lost):
        at = taken[taken[:, 0] > 0.997] if kind == 0 else taken[taken[:, 0] < 0.003]
        if len(at) < 12:
            lost = np.array([True, True])
            continue
        # Saturation makes the ring look wider than it is: what its edges reach is trimmed away.
        for _ in range(3):
            plane = np.column_stack([np.ones(len(at)), at[:, 1:3]])
            solution, *_ = np.linalg.lstsq(plane, at[:, 3], rcond=None)
            rest = at[:, 3] - plane @ solution
            scatter = max(1.4826 * float(np.median(np.abs(rest))), 0.3)
            at = at[np.abs(rest - np.median(rest)) < 4.0 * scatter]
        levels[kind] = solution[0]
        # Of the grey values' steps, the mean square knows; the median, which trims, does not.
        square = np.mean((at[:, 3] - at[:, 1:3] @ solution[1:] - solution[0]) ** 2)
        variances[kind] = max(float(square), 1.0 / 12.0)
        pixels[kind] = len(at) - 3.0
        slopes[2 * kind : 2 * kind + 2] = solution[1:]
        block = slice(3 * kind, 3 * kind + 3)
        normal[block, block] = plane.T @ plane
    return Light(
        levels=levels,
        variances=variances,
        pixels=pixels,
        slopes=slopes,
        normal=normal,
        clipped=lost,
    )


def slopes_prior(
    reading: RingReading, light: Light | None, read: float, gain: float
) -> tuple[Floats, Floats]:
    """Return information (4, 4) and mean (4,) of F's and B's slopes, from the ring."""
    shape, r = reading.outline, reading.radius_px
    contrast = abs(float(shape[5] - shape[6]))
    if light is None:
        return np.eye(4) / (0.1 * contrast) ** 2, np.zeros(4)
    mean = light.slopes
    if light.clipped.any():
        mean = np.where(np.repeat(light.clipped, 2), 0.0, mean)
    # Light bends not quite alike in all directions: what that may do to the slope, per dot radius.
    bend = 1e-7 * r * r + 1e-4
    unseen = _UNSEEN if reading.sign > 0 else _UNSEEN[::-1].copy()
    information = slope_information(
        light.normal, light.variances, light.levels, light.clipped, read, gain, contrast, bend,
        unseen,
    )  # fmt: skip
    return information, mean


def noise(around: Sequence[Light | None]) -> tuple[float, float]:
    """Return the variance of a grey value I, read + gain I, from the scatter about all planes."""
    lights = [light for light in around if light is not None]
    if not lights:
        return 4.0, 0.0
    x = np.maximum(np.concatenate([light.levels for light in lights]), 0.0)
    v = np.concatenate([light.variances for light in lights])
    w = np.concatenate([light.pixels for light in lights])
    x, v, w = x[w > 4.0], v[w > 4.0], w[w > 4.0]
    if len(x) == 0:
        return 4.0, 0.0
    w = w / np.maximum(v, 1e-3)
    gain = 0.0
    mean_x, mean_v = np.average(x, weights=w), np.average(v, weights=w)
    spread = np.average((x - mean_x) ** 2, weights=w)
    if spread > 1.0:
        gain = max(float(np.average((x - mean_x) * (v - mean_v), weights=w) / spread), 0.0)
    read = float(mean_v - gain * mean_x)
    if read < 1.0 / 12.0:
        read = 1.0 / 12.0
        gain = max(float(np.sum(w * x * (v - read)) / max(np.sum(w * x * x), 1e-9)), 0.0)
    return read, gain
