"""Adjust a camera to a dot at places that a coordinate measuring machine knows.

Each place is seen once, so its own uncertainty is carried over into the pixels (covariance
J Σ Jᵀ): the same as if its three coordinates were unknowns that were observed, without them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Block, Group, Problem, Solution, solve
from omm_core.adjustment.problem import Values
from omm_core.camera_calibration.cmm_result import result_of_places
from omm_core.camera_calibration.cmm_start import best_start
from omm_core.camera_calibration.model import PARAMETERS, Sensor, project_with_derivatives
from omm_core.camera_calibration.moving import moved_while_taken
from omm_core.camera_calibration.openness import (
    camera_information,
    open_directions,
    sizes,
    words_for,
)
from omm_core.camera_calibration.result import CalibrationResult, require_determined
from omm_core.camera_calibration.start import start_from_places
from omm_core.camera_calibration.weeding import Weeded, weed
from omm_core.errors import MeasurementError
from omm_core.imaging.circle import circle_points

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Sizes (openness.py) within which a camera is held to its start until it is known to be closed.
_LOOSE = 10.0
# An image farther than this from where the robust start has it is not used to begin with.
_ASTRAY_PX = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """The dot's images, and where it stood.

    Attributes
    ----------
    outlines : (N, K, 3) array
        Points on the edge of the dot at each place, taper frame, mm.
    pixels, covariance_px2 : (N, 2), (N, 2, 2) arrays
        Centres of its images.
    sigma_xyz_mm : float
        Of each coordinate of a place.
    """

    sensor: Sensor
    outlines: Array
    pixels: Array
    covariance_px2: Array
    sigma_xyz_mm: float


def calibrate_by_places(
    sensor: Sensor,
    *,
    images: list[str],
    places: Array,
    pixels: Array,
    covariance_px2: Array,
    sigma_xyz_mm: float,
    normal: Array,
    dot_diameter_mm: float,
    hint: Array | None = None,
) -> CalibrationResult:
    """Calibrate.

    Parameters
    ----------
    sensor : Sensor
    images : list of str
        A name for each observation.
    places : (N, 3) array
        Centres of the dot, taper frame, mm.
    pixels, covariance_px2 : (N, 2), (N, 2, 2) arrays
        Centres of the dot's images.
    sigma_xyz_mm : float
        Of each coordinate of a place.
    normal, dot_diameter_mm : (3,) array, float
        Of the dot, taper frame.
    hint : (13,) array, optional
        A camera that may be near.

    Raises
    ------
    MeasurementError
        If the set leaves the camera open, or no camera fits.
    """
    n = len(places)
    if 2 * n < len(PARAMETERS) + 3:
        raise MeasurementError(f"Expected at least 8 images of the dot, got {n}. Take more.")
    outlines = circle_points(places, np.tile(normal, (n, 1)), np.full(n, dot_diameter_mm))
    starts = start_from_places(sensor, places, pixels)
    camera = best_start(sensor, outlines, pixels, starts if hint is None else [*starts, hint])
    used = _at_hand(sensor, camera, outlines, pixels)
    seen = _Seen(
        sensor=sensor,
        outlines=outlines,
        pixels=pixels,
        covariance_px2=covariance_px2,
        sigma_xyz_mm=sigma_xyz_mm,
    )
    near = _closed(seen, used, camera)
    weeded = weed(
        partial(_adjust, seen, camera=near),
        np.arange(n),
        used,
        least=9,
        refuse_moved=partial(_refuse_moved, images),
    )
    require_determined(sensor, weeded.solution)
    halves_chi2 = _halves(seen, weeded)
    return result_of_places(weeded, sensor, images, places, pixels, halves_chi2=halves_chi2)


def _adjust(
    seen: _Seen,
    used: Mask,
    camera: Array,
    prior_sigma: Array | None = None,
) -> tuple[Problem, Solution]:
    prior = None if prior_sigma is None else prior_sigma[None]
    about = None if prior is None else camera[None]

    def evaluate(values: Values) -> tuple[Array, dict[str, Array]]:
        centres, by_camera, _ = project_with_derivatives(
            seen.sensor, values["camera"][0], seen.outlines
        )
        return centres, {"camera": by_camera}

    for _ in range(2):  # the second time with the places' uncertainty seen from the right camera
        by_place = project_with_derivatives(seen.sensor, camera, seen.outlines)[2].sum(axis=1)
        block = Block(
            name="pixels",
            observed=seen.pixels,
            covariance=seen.covariance_px2
            + seen.sigma_xyz_mm**2 * by_place @ np.swapaxes(by_place, 1, 2),
            index={"camera": np.zeros(len(seen.pixels), dtype=int)},
            evaluate=evaluate,
            used=used,
        )
        group = Group(
            name="camera", values=camera[None], names=PARAMETERS, sigma=prior, observed=about
        )
        problem = Problem(groups=(group,), blocks=(block,))
        solution = solve(problem)
        camera = solution.values["camera"][0]
    return problem, solution


def _at_hand(sensor: Sensor, camera: Array, outlines: Array, pixels: Array) -> Mask:
    """Return which images are near where a robust start has them; all where most are not."""
    away = np.linalg.norm(pixels - project_with_derivatives(sensor, camera, outlines)[0], axis=1)
    near = np.asarray(away < max(_ASTRAY_PX, 5 * float(np.median(away))))
    return near if near.mean() >= 0.8 else np.ones(len(pixels), dtype=bool)


def _refuse_moved(images: list[str], problem: Problem, solution: Solution) -> None:
    """Raise MeasurementError where the camera stood elsewhere from some image on."""
    (block,) = problem.blocks
    by_pose = solution.derivatives["pixels"]["camera"][:, :, 7:]
    moved = moved_while_taken(block, solution, by_pose, np.arange(len(images)))
    if moved is None:
        return
    turn, shift = np.linalg.norm(moved.step[3:]), np.linalg.norm(moved.step[:3])
    raise MeasurementError(
        f"Something moved between image {images[moved.first - 1]} and {images[moved.first]}"
        f" (number {moved.first} and {moved.first + 1} of {len(images)}): the camera, by about"
        f" {shift:.3f} mm and {1000 * turn:.2f} mrad, or the axes of the CMM. Clamp it, and take"
        " the set again. A wrong diameter or normal of the dot, or places that are not in mm, look"
        " alike."
    )


def _closed(
    seen: _Seen,
    used: Mask,
    camera: Array,
) -> Array:
    """Return the camera held loosely near a start; raise MeasurementError where it is open."""
    size = sizes(seen.sensor, camera[0])
    problem, solution = _adjust(seen, used, camera, _LOOSE * size)
    known = camera_information(problem, solution.values) - np.diag((_LOOSE * size) ** -2.0)
    opened = open_directions(known, size)
    if opened:
        raise MeasurementError(
            f"The set leaves {words_for(opened)}. Spread the dots over the whole image and over"
            " several distances."
        )
    return solution.values["camera"][0]


def _halves(seen: _Seen, weeded: Weeded) -> float | None:
    """Return the squared difference of the cameras of two halves over its covariance.

    Chi-square with 13 degrees of freedom where the model and its covariance hold; None for sets
    of which a half is too few.
    """
    used, sigma0 = weeded.used, weeded.solution.sigma0
    if used.sum() < 40:
        return None
    camera = weeded.solution.values["camera"][0]
    cameras, covariances = [], []
    for parity in range(2):
        half = used & (np.cumsum(used) % 2 == parity)
        solution = _adjust(seen, half, camera)[1]
        if solution.undetermined or not solution.converged:
            return None
        cameras.append(solution.values["camera"][0])
        covariances.append(solution.covariance)
    difference, together = cameras[0] - cameras[1], covariances[0] + covariances[1]
    scale = np.sqrt(np.diag(together)) * max(sigma0, 1.0)
    correlation = together / np.outer(scale, scale) * max(sigma0, 1.0) ** 2
    unit = difference / scale
    return float(unit @ np.linalg.solve(correlation, unit))
