"""From a number to a centre with its covariance, or to a reason why it cannot be trusted."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.targets.coded.families import TargetFamily
from omm_core.targets.coded.judging import RingReading, radius, refusal
from omm_core.targets.coded.light import (
    MIXED,
    MIXED_ONCE_FITTED,
    Light,
    light_around,
    noise,
    slopes_prior,
)
from omm_core.targets.coded.uneven_outline import grey_unit, outline_uneven
from omm_core.targets.conic.clustered import clustered_covariance
from omm_core.targets.conic.dot_equations import SlopesPrior
from omm_core.targets.conic.dot_fit import Fitted, fit_dot, start_at
from omm_core.targets.conic.dot_model import B0, BLUR, BX, BY, F0, FX, FY, Noise, Ring
from omm_core.targets.conic.outline import (
    LEVEL_IN,
    LEVEL_OUT,
    OFF,
    WIDTH,
    XX,
    XY,
    YY,
    semi_axes,
    square_root,
)
from omm_core.targets.detected import DetectedTarget, RefusedTarget
from omm_core.words import keyed

Floats = NDArray[np.float64]

SMALL_PX = 8.0
"""Smaller semi-axis below which light is looked at again when the dot has been fitted."""
MAX_MISFIT = 4.0
"""χ² per degree of freedom from which on it is not noise alone; the covariance grows with it."""
UNEVEN_SHARE = 0.06
"""Error of a centre (dot radii) where light falls by all of the contrast over a dot's radius; it
grows with the square (drawn, a dot of 16 px: 0.045 px where light is 0.55 at the ring)."""
ROUGH = 0.03
"""Error of the model, of the contrast, with which a fit that did not settle is tried once more."""
EDGES_SHARE = 0.01
"""Error of the ellipse through the edges (dot radii) where a beam ends on the dot (drawn: see
test_targets_uneven)."""
NOT_NOISE = 1.3
"""χ² per degree of freedom from which on the residuals are looked at one by one (of a dot of 12 px
with 300 pixels, noise alone reaches that in one of 10,000)."""
MAX_RESIDUAL = 0.06
"""RMS of the residuals, of the contrast, from which on something lies on the dot. Below, misfit
comes from what the camera does to edges (sharpening, JPEG), which is the same on all sides."""


def centre_of_outline(reading: RingReading) -> DetectedTarget:
    """Return the outline's ellipse as the result; its covariance comes from its points' scatter."""
    shape = reading.outline
    scatter = max(float(shape[OFF]), 0.01) ** 2
    return _result(reading, shape[: YY + 1], np.eye(2) * scatter * 2.0 / 40.0, shape[WIDTH])


def centre_all(
    image: NDArray[Any], family: TargetFamily, readings: list[RingReading], saturation: float
) -> list[DetectedTarget | RefusedTarget]:
    """Learn light and noise from the areas of all rings, then fit all dots."""
    readings = list(readings)
    lights = [light_around(image, family, reading, saturation) for reading in readings]
    read, gain = noise(lights)
    again = [i for i, light in enumerate(lights) if _is_to_see_again(readings[i], light)]
    for i in again:
        fit = _fit(image, family, readings[i], read, gain, saturation, lights[i])
        if fit is not None:
            outline = readings[i].outline.copy()
            outline[: YY + 1], outline[WIDTH] = fit.p[: YY + 1], fit.p[BLUR]
            readings[i] = replace(readings[i], outline=outline)
            mixed = MIXED if _is_clipped(lights[i]) else MIXED_ONCE_FITTED
            lights[i] = light_around(image, family, readings[i], saturation, mixed)
    if again:
        read, gain = noise(lights)
    return [
        _judged(image, family, reading, read, gain, saturation, light)
        for reading, light in zip(readings, lights, strict=True)
    ]


def _judged(
    image: NDArray[Any],
    family: TargetFamily,
    reading: RingReading,
    read: float,
    gain: float,
    saturation: float,
    light: Light | None,
) -> DetectedTarget | RefusedTarget:
    """Fit a dot, and once more as one that its model does not describe to within the noise."""
    fit = _fit(image, family, reading, read, gain, saturation, light)
    if fit is None:
        contrast = float(reading.outline[LEVEL_IN] - reading.outline[LEVEL_OUT])
        rough = read + (ROUGH * contrast) ** 2
        fit = _fit(image, family, reading, rough, gain, saturation, light)
    outcome = _judge(reading, fit)
    if fit is not None and isinstance(outcome, DetectedTarget) and _errs_alike(fit, light):
        outcome = _as_wide_as_its_residuals(
            image, family, reading, Noise(read, gain, saturation), light, fit.p, outcome
        )
    if reading.uneven or (fit is not None and _is_rough(fit)):
        return _by_the_edges(image, reading, outcome)
    return outcome


def _errs_alike(fit: Fitted, light: Light | None) -> bool:
    """Whether the residuals are worse than noise, and not for what is saturated."""
    return fit.misfit > NOT_NOISE and not _is_clipped(light)


def _as_wide_as_its_residuals(
    image: NDArray[Any],
    family: TargetFamily,
    reading: RingReading,
    grey: Noise,
    light: Light | None,
    p: Floats,
    target: DetectedTarget,
) -> DetectedTarget:
    """Return the target, as uncertain as it is where neighbouring pixels of an edge err alike."""
    prior, _ = slopes_prior(reading, light, grey.read, grey.gain)
    ring = Ring(family.ring_inner_ratio, reading.bits, reading.phase_rad)
    seen = clustered_covariance(image, reading.outline, ring, grey, prior, p)
    wider = math.sqrt(np.linalg.det(seen) / np.linalg.det(target.covariance_px2))
    return replace(target, covariance_px2=target.covariance_px2 * max(wider, 1.0))


def _is_rough(fit: Fitted) -> bool:
    """Whether the model is off by what a beam's edge on the dot would do."""
    return fit.residual > ROUGH * abs(fit.contrast) and fit.misfit > MAX_MISFIT


def _by_the_edges(
    image: NDArray[Any], reading: RingReading, fitted: DetectedTarget | RefusedTarget
) -> DetectedTarget | RefusedTarget:
    """Return the fit, or where that is off them the ellipse through the steepest edges.

    These ask nothing of the light, so a beam's edge or a shadow on the dot moves them little.
    """
    candidate = np.append(reading.outline[:5], reading.sign)
    outline, ok = outline_uneven(image, candidate, grey_unit(image))
    if not ok:
        return fitted
    local = centre_of_outline(replace(reading, outline=outline))
    covariance = local.covariance_px2 + np.eye(2) * (EDGES_SHARE * reading.radius_px) ** 2
    if isinstance(fitted, DetectedTarget):
        off = fitted.center_px - local.center_px
        if off @ np.linalg.solve(covariance + fitted.covariance_px2, off) < 4.0:
            wider = fitted.covariance_px2 + np.outer(off, off) + np.eye(2) * 0.25 * (off @ off)
            return replace(fitted, covariance_px2=wider)
    elif not reading.uneven:
        return fitted
    return replace(local, covariance_px2=covariance)


def _is_to_see_again(reading: RingReading, light: Light | None) -> bool:
    """Return whether to look again: light was taken from edges that were not well known.

    A small dot's outline is known to a tenth of a pixel, and its ring has few pixels away from
    edges. What is saturated looks wider than it is.
    """
    return _is_clipped(light) or semi_axes(*reading.outline[2:5])[0] < SMALL_PX


def _is_clipped(light: Light | None) -> bool:
    return light is not None and bool(light.clipped.any())


def _fit(
    image: NDArray[Any],
    family: TargetFamily,
    reading: RingReading,
    read: float,
    gain: float,
    saturation: float,
    light: Light | None,
) -> Fitted | None:
    shape = reading.outline
    prior, mean = slopes_prior(reading, light, read, gain)
    fitted = start_at(shape)
    fitted.p[[FX, FY, BX, BY]] = mean
    ring = Ring(family.ring_inner_ratio, reading.bits, reading.phase_rad)
    grey, slopes = Noise(read, gain, saturation), SlopesPrior(prior, mean)
    return fitted if fit_dot(image, shape, reading.sign, ring, grey, slopes, fitted) else None


def _judge(reading: RingReading, fit: Fitted | None) -> DetectedTarget | RefusedTarget:
    shape = reading.outline
    if fit is None:
        words = keyed(
            "said.dot_edge",
            "the dot's edge is not that of one evenly lit dot: its centre cannot be trusted",
        )
        return refusal(shape, words)
    p, misfit = fit.p, fit.misfit
    if misfit > MAX_MISFIT and fit.residual > MAX_RESIDUAL * abs(fit.contrast):
        words = keyed(
            "said.dot_covered",
            "something lies on the dot or shines on it: its centre cannot be trusted",
        )
        return refusal(shape, words)
    # What the dot itself shows of the noise counts: it grew by misfit, or was thought too large.
    covariance = fit.covariance * max(misfit, 0.2) + np.eye(2) * _of_the_light(p) ** 2
    return _result(reading, p[: YY + 1], covariance, p[BLUR], abs(fit.contrast))


def _of_the_light(p: Floats) -> float:
    """Return the centre's standard deviation, px, for light that is not a plane."""
    fall = math.hypot(p[FX], p[FY]) / abs(p[F0] - p[B0])
    return UNEVEN_SHARE * fall**2 * radius(p)


def _result(
    reading: RingReading, conic: Floats, covariance: Floats, s: float, contrast: float | None = None
) -> DetectedTarget:
    a11, a12, a22 = square_root(conic[XX], conic[XY], conic[YY])
    smaller, larger = semi_axes(*conic[2:5])
    return DetectedTarget(
        id=reading.id,
        center_px=np.array(conic[:2]),
        covariance_px2=np.array(covariance),
        diameter_px=2.0 * radius(conic),
        axes_px=(2.0 * larger, 2.0 * smaller),
        angle_rad=0.5 * math.atan2(2.0 * a12, a11 - a22),
        phase_rad=reading.phase_rad,
        bright=reading.sign > 0,
        contrast_dn=float(
            abs(reading.outline[LEVEL_IN] - reading.outline[LEVEL_OUT])
            if contrast is None
            else contrast
        ),
        blur_px=float(s),
        ring_margin=reading.margin,
    )
