"""From a candidate to a number that can be trusted, and from a number to a centre.

Each step either hands on or gives a reason that a person understands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.targets import reading
from omm_core.targets.centring import (
    PARAMETERS,
    fit_dot,
    planes_of,
    ring_light,
    ring_scatter,
    slope_information,
)
from omm_core.targets.families import TargetFamily
from omm_core.targets.reading import read_candidates, read_ring, square_root, within_any

Floats = NDArray[np.float64]

LEAN_RADIUS_PX = 24.0
"""Smaller semi-axis from which on perspective is looked for within a target."""
LEANS = np.array([-0.06, -0.04, -0.02, 0.0, 0.02, 0.04, 0.06])
"""Radius of the dot by its distance that is tried (a dot of 15 mm at 150 mm: 0.05)."""
_FROM_THE_MIDDLE = (2, 4, 1, 5, 0, 6)
MIN_LEAN_GAIN = 0.9
"""By how much the ring must fit better with perspective (of the squared error) to believe it."""
MAX_MISFIT = 4.0
"""χ² per degree of freedom from which on it is not noise alone; the covariance grows with it."""
MAX_RESIDUAL = 0.06
"""RMS of the residuals, of the contrast, from which on something lies on the dot. Below, misfit
comes from what the camera does to edges (sharpening, JPEG), which is the same on all sides."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """A dot with a ring that was read.

    Attributes
    ----------
    outline : (9,) see `reading.outline`.
    lean : (2,) the perspective's share, see `reading.ring_profile`.
    sign : +1 bright dot, -1 dark dot.
    bits : (n,) 0/1 clockwise from `phase_rad`, as seen; not yet rotated to the code.
    """

    id: int
    outline: Floats
    lean: Floats
    sign: int
    bits: NDArray[np.int64]
    phase_rad: float
    margin: float

    @property
    def radius_px(self) -> float:
        """Radius of the circle with the ellipse's area."""
        return _radius(self.outline)


def _radius(conic: Floats) -> float:
    return float((conic[2] * conic[4] - conic[3] ** 2) ** -0.25)


def _refused(conic: Floats, reason: str) -> dict[str, Any]:
    return {
        "center_px": conic[:2].copy(),
        "diameter_px": 2.0 * _radius(conic),
        "reason": reason,
    }


def read_targets(
    image: NDArray[Any], family: TargetFamily, candidates: Floats
) -> tuple[list[Reading], list[dict[str, Any]]]:
    """Outlines and numbers of the candidates (N, 6), large ones first; and what was refused."""
    dots, shapes, bits, facts, doubts = read_candidates(
        image, candidates, family.ring_inner_ratio, family.ring_outer_ratio, family.bits
    )
    readings: list[Reading] = []
    rings = np.empty((len(dots), 5))
    refused = []
    for i, shape in enumerate(shapes):
        lean = np.zeros(2)
        bits_seen, seen, against = bits[i], facts[i], int(doubts[i])
        if within_any(rings, len(readings), shape[0], shape[1], family.ring_outer_ratio):
            continue
        # Perspective blurs a ring; it does not make one of nothing, or of the image's border.
        if against in (reading.CUT, reading.NO_RING):
            leaning = None
        else:
            leaning = _perspective(image, family, shape, seen)
        if leaning is not None:
            lean = leaning
            bits_seen, seen = _read(image, family, shape, lean)
            against = reading.doubt(seen)
        if against == reading.NO_RING:
            continue  # nothing ring-like is there, which is not worth a word
        sign = int(candidates[dots[i], 5])
        outcome = _number(family, shape, lean, sign, bits_seen, seen, against)
        if isinstance(outcome, Reading):
            rings[len(readings)] = shape[:5]
            readings.append(outcome)
        else:
            refused.append(outcome)
    return readings, refused


_DOUBTS = {
    reading.CUT: "the ring is cut by the border of the image",
    reading.UNCLEAR: "a sector of the ring is neither set nor clear",
    reading.COVERED: "the ring does not look as its own bits let expect: "
    "something lies on it, or light falls on it",
    reading.FILLED: "something lies between dot and ring",
}


def _number(
    family: TargetFamily,
    shape: Floats,
    lean: Floats,
    sign: int,
    bits: NDArray[np.int64],
    facts: Floats,
    against: int,
) -> Reading | dict[str, Any]:
    """A reading, or a refusal."""
    if against == reading.OTHER_WIDTH:
        return _refused(shape, f"the ring is not as wide as those of {family.name}")
    if against != reading.NONE:
        return _refused(shape, _DOUBTS[against])
    code = int("".join(map(str, bits)), 2)
    target_id = family.id_of(code)
    if target_id is None:
        return _refused(shape, f"the ring reads {code:0{family.bits}b}: no code of {family.name}")
    return Reading(
        id=target_id,
        outline=shape,
        lean=lean,
        sign=sign,
        bits=bits,
        phase_rad=float(facts[0]),
        margin=float(facts[1]),
    )


def _perspective(
    image: NDArray[Any], family: TargetFamily, shape: Floats, straight: Floats
) -> Floats | None:
    """How much larger the near side of a tilted target is than its far side, (2,) per dot radius.

    It lies along the ellipse's smaller axis. None where there is none to be seen, as of a small
    dot, which is far away.
    """
    if _radius(shape) < LEAN_RADIUS_PX:
        return None
    a11, a12, a22 = square_root(shape[2], shape[3], shape[4])
    half = math.hypot(a11 - a22, 2.0 * a12)
    smaller, larger = 0.5 * (a11 + a22 - half), 0.5 * (a11 + a22 + half)
    if smaller < LEAN_RADIUS_PX or larger < 1.04 * smaller:
        return None
    angle = 0.5 * math.atan2(2.0 * a12, a11 - a22) + 0.5 * math.pi
    axis = np.array([math.cos(angle), math.sin(angle)])
    # Lean is the dot's radius by its distance, times the sine of the tilt.
    leans = LEANS * math.sqrt(1.0 - (smaller / larger) ** 2)
    middle = len(leans) // 2
    errors = np.full(len(leans), math.nan)
    errors[middle] = _ring_error(straight)
    for i in _FROM_THE_MIDDLE:
        errors[i] = _ring_error(_read(image, family, shape, leans[i] * axis)[1])
        # Where a ring is read and fits worse on both sides, it fits best as it is.
        near = errors[middle - 1 : middle + 2]
        if near[1] < 1.0 and near[0] >= near[1] <= near[2]:
            return None
    best = int(np.nanargmin(errors)) if np.isfinite(errors).any() else middle
    if errors[best] ** 2 > MIN_LEAN_GAIN * errors[middle] ** 2:
        return None
    if not 0 < best < len(leans) - 1 or not np.isfinite(errors[best - 1 : best + 2]).all():
        return np.asarray(leans[best] * axis)
    before, at, after = errors[best - 1 : best + 2] ** 2
    bend = before - 2.0 * at + after
    shift = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return np.asarray((leans[best] + shift * (leans[1] - leans[0])) * axis)


def _read(
    image: NDArray[Any], family: TargetFamily, shape: Floats, lean: Floats
) -> tuple[NDArray[np.int64], Floats]:
    """Bits and facts of `reading.read_ring`."""
    ring = (family.ring_inner_ratio, family.ring_outer_ratio, family.bits)
    bits, facts = read_ring(image, shape, lean, *ring)
    return bits, facts


def _ring_error(facts: Floats) -> float:
    """RMS of what is seen of the ring less what its bits let expect; NaN outside the image."""
    if math.isnan(facts[0]):
        return math.nan
    unread = facts[1] < 0.1 or facts[7] < 0.5
    return 1.0 if unread else float(facts[3])


def centre_of_outline(reading: Reading) -> dict[str, Any]:
    """The outline's ellipse as result; its covariance from the scatter of its points."""
    scatter = max(float(reading.outline[7]), 0.01) ** 2
    return _result(
        reading, reading.outline[:5], np.eye(2) * scatter * 2.0 / 40.0, reading.outline[8]
    )


def centre_all(
    image: NDArray[Any], family: TargetFamily, readings: list[Reading], saturation: float
) -> list[dict[str, Any]]:
    """Learn light and noise from the areas of all rings, then fit all dots."""
    readings = list(readings)
    lights = [_ring_light(image, family, reading, saturation) for reading in readings]
    read, gain = _noise(lights)
    clipped = [i for i, light in enumerate(lights) if light is not None and light.clipped.any()]
    for i in clipped:
        fit = _fit(image, family, readings[i], read, gain, saturation, lights[i])
        if fit is not None:
            # What is saturated looks wider than it is, so that light was taken from edges too.
            # Now that the size is known: once more.
            outline = np.concatenate([fit[0][:5], readings[i].outline[5:8], fit[0][5:6]])
            readings[i] = replace(readings[i], outline=outline)
            lights[i] = _ring_light(image, family, readings[i], saturation)
    if clipped:
        read, gain = _noise(lights)
    return [
        _judge(reading, _fit(image, family, reading, read, gain, saturation, light))
        for reading, light in zip(readings, lights, strict=True)
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Light:
    """Planes of light F (set) and B (clear) around a dot, slopes per dot radius.

    Attributes
    ----------
    levels, variances, pixels : (2,) of set and clear.
    slopes : (4,) fx, fy, bx, by.
    clipped : (2,) whether pixels are saturated (or 0), so that set or clear tell nothing of light.
    normal : (8, 8) normal matrix of `centring.ring_light`, for a variance of 1.
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
MIXED = (0.01, 0.12)
"""Share of set in a clear pixel, or of clear in a set one, up to which it tells of light. With the
second a dot of 12 px is off by 0.002 px, so it serves only where there are too few pixels."""


def _ring_light(
    image: NDArray[Any], family: TargetFamily, reading: Reading, saturation: float
) -> _Light | None:
    """Light around the dot, or None where too little of the ring can be used."""
    s = max(float(reading.outline[8]), 0.35)
    for mixed in MIXED:
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
            mixed,
        )
        if count.min() >= 12:
            break
    lost = clipped > 0.02 * count
    if lost.any():
        return _half_clipped(taken, lost)
    planes, solvable = planes_of(normal, right)
    if count.min() < 6 or not solvable:
        return None
    squares, count = ring_scatter(taken, planes)
    pixels = np.maximum(count - 3.0, 0.0)
    return _Light(
        levels=planes[[0, 3]],
        variances=np.maximum(squares / np.maximum(pixels, 1.0), 1.0 / 12.0),
        pixels=pixels,
        slopes=planes[_SLOPES],
        normal=normal,
        clipped=lost,
    )


def _half_clipped(taken: Floats, lost: NDArray[np.bool_]) -> _Light:
    """Light where set or clear is clipped: of the other the plane, from pixels far from edges."""
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
    return _Light(
        levels=levels,
        variances=variances,
        pixels=pixels,
        slopes=slopes,
        normal=normal,
        clipped=lost,
    )


def _fit(
    image: NDArray[Any],
    family: TargetFamily,
    reading: Reading,
    read: float,
    gain: float,
    saturation: float,
    light: _Light | None,
) -> tuple[Floats, Floats, Floats] | None:
    """Parameters, covariance and statistics of `centring.fit_dot`, or None."""
    shape = reading.outline
    prior, mean = _light_prior(reading, light, read, gain)
    p = np.zeros(PARAMETERS)
    p[:5] = shape[:5]
    p[5] = max(float(shape[8]), 0.35)
    p[6], p[9] = shape[5], shape[6]
    p[[7, 8, 10, 11]] = mean
    covariance, statistics = np.zeros((2, 2)), np.zeros(6)
    ok = fit_dot(
        image,
        shape,
        reading.sign,
        family.ring_inner_ratio,
        reading.bits,
        reading.phase_rad,
        read,
        gain,
        saturation,
        prior,
        mean,
        p,
        covariance,
        statistics,
    )
    return (p, covariance, statistics) if ok else None


def _light_prior(
    reading: Reading, light: _Light | None, read: float, gain: float
) -> tuple[Floats, Floats]:
    """Information (4, 4) and mean (4,) of the slopes of F and B, from the areas of the ring."""
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


def _noise(around: list[_Light | None]) -> tuple[float, float]:
    """Variance of a grey value I as read + gain I, from the scatter about all planes."""
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


def _judge(reading: Reading, fit: tuple[Floats, Floats, Floats] | None) -> dict[str, Any]:
    shape = reading.outline
    if fit is None:
        return _refused(
            shape, "the dot's edge is not that of one evenly lit dot: its centre cannot be trusted"
        )
    p, covariance, statistics = fit
    free = max(float(statistics[5]) - PARAMETERS, 1.0)
    misfit = float(statistics[4]) / free
    residual = math.sqrt((statistics[1] + statistics[3]) / (free + PARAMETERS))
    if misfit > MAX_MISFIT and residual > MAX_RESIDUAL * abs(p[6] - p[9]):
        return _refused(
            shape, "something lies on the dot or shines on it: its centre cannot be trusted"
        )
    # What the dot itself shows of the noise counts: it grew by misfit, or was thought too large.
    covariance = covariance * max(misfit, 0.2)
    return _result(reading, p[:5], covariance, p[5], abs(p[6] - p[9]))


def _result(
    reading: Reading, conic: Floats, covariance: Floats, s: float, contrast: float | None = None
) -> dict[str, Any]:
    a11, a12, a22 = square_root(conic[2], conic[3], conic[4])
    mean, half = a11 + a22, math.hypot(a11 - a22, 2.0 * a12)
    return {
        "id": reading.id,
        "center_px": np.array(conic[:2]),
        "covariance_px2": np.array(covariance),
        "diameter_px": 2.0 * _radius(conic),
        "axes_px": (mean + half, mean - half),
        "angle_rad": 0.5 * math.atan2(2.0 * a12, a11 - a22),
        "phase_rad": reading.phase_rad,
        "bright": reading.sign > 0,
        "contrast_dn": float(
            abs(reading.outline[5] - reading.outline[6]) if contrast is None else contrast
        ),
        "blur_px": float(s),
        "ring_margin": reading.margin,
    }
