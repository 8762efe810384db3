"""The best of several starts for known places, by robust adjustments with points for dots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Block, Group, Problem, Solution, solve
from omm_core.adjustment.problem import Values
from omm_core.camera_calibration.model import Sensor, project_with_derivatives
from omm_core.camera_calibration.start import start_from_places
from omm_core.camera_calibration.weeding import robust_inflation
from omm_core.errors import MeasurementError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROBUST_ROUNDS = 8
_ENOUGH = 200  # images of a set for a start
# A start from which the middle image is farther than this is none (image widths).
_NONE = 0.01


def best_start(sensor: Sensor, outlines: Array, pixels: Array, starts: list[Array]) -> Array:
    """Return the camera that fits best after a robust adjustment from each start.

    Raises
    ------
    MeasurementError
        Where none fits, with what is mirrored if that is why.
    """
    some = np.linspace(0, len(pixels) - 1, min(len(pixels), _ENOUGH)).astype(int)
    points, pixels = outlines[some].mean(axis=1, keepdims=True), pixels[some]
    left, camera = _fitted(sensor, points, pixels, starts)
    if left < _NONE * sensor.width_px:
        return camera
    mirrored = points * [-1.0, 1.0, 1.0]
    left, _ = _fitted(sensor, mirrored, pixels, start_from_places(sensor, mirrored[:, 0], pixels))
    if left < _NONE * sensor.width_px:
        raise MeasurementError(
            "The places are a mirror image of what the camera saw: one of their axes has the wrong"
            " sign, or two of x, y, z, or col and row, are exchanged. Check the columns, and that"
            " the places are in the taper's frame (right-handed)."
        )
    raise MeasurementError(
        "No camera fits the set. Check which image belongs to which place, the axes of the places"
        " (taper frame), that they are in mm, and the size of the sensor."
    )


def _fitted(
    sensor: Sensor, points: Array, pixels: Array, starts: list[Array]
) -> tuple[float, Array]:
    """Return the median residual (px) and the camera that fits points (N, 1, 3) best.

    The residual is infinite where no camera sees all points.
    """
    found: list[tuple[float, Array]] = []
    held = np.zeros((1, 13), dtype=bool)
    held[0, 3:7] = True
    wide = np.tile(np.eye(2), (len(pixels), 1, 1))

    def fitted(camera: Array, hold: Mask, inflation: Array) -> Solution:
        block = Block(
            name="pixels",
            observed=pixels,
            covariance=wide * inflation[:, None, None],
            index={"camera": np.zeros(len(pixels), dtype=int)},
            evaluate=evaluate,
        )
        group = Group(name="camera", values=camera[None], held=hold)
        return solve(Problem(groups=(group,), blocks=(block,)), iterations=10)

    def evaluate(values: Values) -> tuple[Array, dict[str, Array]]:
        centres, by_camera, _ = project_with_derivatives(sensor, values["camera"][0], points)
        return centres, {"camera": by_camera}

    for start in starts:
        predicted = project_with_derivatives(sensor, start, points)[0]
        seen = np.isfinite(predicted).all(axis=1)
        if not seen.all():
            continue
        camera = start
        inflation, before = np.ones(len(pixels)), np.inf
        for hold in (held, *[np.zeros_like(held)] * _ROBUST_ROUNDS):
            solution = fitted(camera, hold, inflation)
            camera = solution.values["camera"][0]
            residuals = solution.residuals["pixels"]
            away = np.linalg.norm(residuals, axis=1)
            if hold is not held and (away.max() < 1.0 or np.median(away) > 0.98 * before):
                break
            before = np.inf if hold is held else float(np.median(away))
            inflation = robust_inflation(residuals)
        left = float(np.median(np.linalg.norm(solution.residuals["pixels"], axis=1)))
        found.append((left, camera))
        if left < 1.0:
            break
    return min(found, key=lambda pair: pair[0], default=(np.inf, np.zeros(len(held[0]))))
