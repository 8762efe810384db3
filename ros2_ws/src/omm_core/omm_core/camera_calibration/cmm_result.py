"""What is told of a camera that was adjusted to places of a dot: residuals, findings, doubts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Solution
from omm_core.camera_calibration.further_terms import further_terms, words_of_missed
from omm_core.camera_calibration.model import Sensor
from omm_core.camera_calibration.patterns import planes_of, residual_patterns, words_of_patterns
from omm_core.camera_calibration.result import CalibrationResult, DotObservation
from omm_core.camera_calibration.weeding import Weeded
from omm_core.geometry import rotation_from_euler_xyz_rad

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Chi-square of 13 degrees of freedom that one good set in a thousand exceeds.
_LARGEST_HALVES = 34.5
# Residuals so much smaller than promised are no chance with so many degrees of freedom.
_TOO_GOOD, _ENOUGH_FREEDOM = 0.5, 30


def result_of_places(
    weeded: Weeded,
    sensor: Sensor,
    images: list[str],
    places: Array,
    pixels: Array,
    *,
    halves_chi2: float | None,
) -> CalibrationResult:
    """Return the result with what the residuals tell of the lens model.

    Parameters
    ----------
    weeded : Weeded
        The adjustment of the ``camera`` to the block ``pixels``.
    images : list of str
        A name for each observation.
    places, pixels : (N, 3), (N, 2) arrays
        Centres of the dot, taper frame, mm; of its images.
    halves_chi2 : float, optional
        Of the difference of the cameras of two halves, 13 degrees of freedom.
    """
    solution, used = weeded.solution, weeded.used
    (block,) = weeded.problem.blocks
    camera = solution.values["camera"][0]
    terms = further_terms(sensor, camera, block, solution)
    planes = {"plane": planes_of(places[:, 2])}
    patterns = residual_patterns(sensor, camera, block, solution, planes)
    extra: dict[str, Any] = {
        "further_terms": [t.to_json_dict() for t in terms],
        "patterns": [p.to_json_dict() for p in patterns],
    }
    if halves_chi2 is not None:
        extra |= {"halves_chi2": halves_chi2, "halves_degrees_of_freedom": 13}
    observations = (
        DotObservation(image=image, pixel=pixel, residual_px=-residual, reason=reason)
        for image, pixel, residual, reason in zip(
            images, pixels, solution.residuals["pixels"], weeded.reasons, strict=True
        )
    )
    return CalibrationResult(
        sensor=sensor,
        camera=camera,
        covariance=solution.covariance * max(solution.sigma0, 1.0) ** 2,
        sigma0=solution.sigma0,
        degrees_of_freedom=solution.degrees_of_freedom,
        converged=solution.converged,
        observations=tuple(observations),
        images=int(used.sum()),
        covered_mm=_covered(sensor, camera, places),
        dots_mm=places,
        findings=(
            *_findings(solution, used, images),
            *_contradiction(halves_chi2),
            *words_of_missed(terms),
            *words_of_patterns(patterns),
        ),
        extra=extra,
    )


def _contradiction(halves_chi2: float | None) -> tuple[str, ...]:
    if halves_chi2 is None or halves_chi2 < _LARGEST_HALVES:
        return ()
    return (
        f"two halves of the set give cameras that differ more than their covariances allow (chi-"
        f"square {halves_chi2:.0f} with 13 degrees of freedom): the lens model or the places are"
        " wrong, or something moved",
    )


def _covered(sensor: Sensor, camera: Array, places: Array) -> tuple[float, float]:
    depth = (places - camera[7:10]) @ rotation_from_euler_xyz_rad(*camera[10:])[:, 2]
    return float(depth.min()), float(depth.max())


def _findings(solution: Solution, used: Mask, images: list[str]) -> tuple[str, ...]:
    found = []
    if not used.all():
        names = ", ".join(images[i] for i in np.flatnonzero(~used)[:5])
        found.append(f"{(~used).sum()} images do not fit the others and are left out: {names}")
    if solution.sigma0 > 1.3:
        found.append(
            f"residuals are {solution.sigma0:.2f} times what was promised; the covariance is"
            " enlarged by that"
        )
    if solution.sigma0 < _TOO_GOOD and solution.degrees_of_freedom >= _ENOUGH_FREEDOM:
        found.append(
            f"residuals are only {solution.sigma0:.2g} of what was promised: sigma_xyz_mm or"
            " sigma_px is too large, and so is the covariance"
        )
    return tuple(found)
