"""The pictures of a calibration: one matplotlib figure each, by name."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from omm_core.camera_calibration.model import PARAMETERS
from omm_core.camera_calibration.result import (
    DISTANCES_MM,
    CalibrationResult,
    projection_sigma_px,
)
from omm_core.files.output import write_whole
from omm_core.geometry import rotation_from_euler_xyz_rad

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def calibration_figures(result: CalibrationResult) -> dict[str, Callable[[], Figure]]:
    """Return what draws each picture, by name."""
    return {
        "projection": lambda: _projection_figure(result),
        "residuals": lambda: _residual_figure(result),
        "distortion": lambda: _distortion_figure(result),
        "correlations": lambda: _correlation_figure(result),
        "geometry": lambda: _geometry_figure(result),
    }


def write_pictures(result: CalibrationResult, folder: Path) -> None:
    """Write each picture as PNG into a folder, which is made where it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in calibration_figures(result).items():
        buffer = io.BytesIO()
        draw().savefig(buffer, format="png", dpi=150, metadata={"Software": None})
        write_whole(folder / f"{name}.png", buffer.getvalue())


def _projection_figure(result: CalibrationResult) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 2.6), layout="constrained")
    near, far = result.covered_mm
    size = (result.sensor.width_px, result.sensor.height_px)
    for axes, distance in zip(figure.subplots(1, 3), DISTANCES_MM, strict=True):
        spread = projection_sigma_px(
            result.sensor, result.camera, result.covariance, distance, steps=25
        )
        extent = (-0.5, size[0] - 0.5, size[1] - 0.5, -0.5)
        drawn = axes.imshow(spread, extent=extent, cmap="viridis")
        outside = "" if near <= distance <= far else " (extrapolated)"
        axes.set_title(f"{distance:.0f} mm{outside}", fontsize=9)
        axes.tick_params(labelsize=6)
        figure.colorbar(drawn, ax=axes, shrink=0.7).ax.tick_params(labelsize=6)
    return figure


def _residual_figure(result: CalibrationResult) -> Figure:
    from matplotlib.figure import Figure

    used = [o for o in result.observations if o.reason is None]
    at = np.array([o.pixel for o in used])
    residual = np.array([o.residual_px for o in used])
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.subplots()
    drawn = 0.02 * result.sensor.width_px
    scale = max(result.rms_px, 1e-9) / drawn
    axes.quiver(*at.T, *residual.T, angles="xy", scale_units="xy", scale=scale, width=0.0015)
    axes.set_title(
        f"an arrow {drawn:.0f} px long is a residual of {result.rms_px:.4f} px", fontsize=9
    )
    _as_sensor(axes, result)
    return figure


def _distortion_figure(result: CalibrationResult) -> Figure:
    from matplotlib.figure import Figure

    lens = result.sensor.lens(result.camera)
    at = lens.pixel_grid(15)
    ideal = lens.normalised_from_pixels(at) * lens.principal_distance_px + lens.principal_point_px
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.subplots()
    axes.quiver(*at.T, *(ideal - at).T, angles="xy", scale_units="xy", scale=0.1, width=0.0015)
    _as_sensor(axes, result)
    return figure


def _as_sensor(axes, result: CalibrationResult) -> None:  # type: ignore[no-untyped-def]
    axes.set_xlim(-0.5, result.sensor.width_px - 0.5)
    axes.set_ylim(result.sensor.height_px - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_xlabel("col, px")
    axes.set_ylabel("row, px")


def _correlation_figure(result: CalibrationResult) -> Figure:
    from matplotlib.figure import Figure

    sigma = np.sqrt(np.diag(result.covariance))
    correlation = result.covariance / np.outer(sigma, sigma)
    figure = Figure(figsize=(6, 5), layout="constrained")
    axes = figure.subplots()
    drawn = axes.imshow(correlation, cmap="RdBu", vmin=-1, vmax=1)
    axes.set_xticks(range(13), PARAMETERS, rotation=90, fontsize=7)
    axes.set_yticks(range(13), PARAMETERS, fontsize=7)
    for i in range(13):
        for j in range(i):
            if abs(correlation[i, j]) > 0.5:
                axes.text(j, i, f"{correlation[i, j]:.2f}", ha="center", va="center", fontsize=5)
    figure.colorbar(drawn, ax=axes)
    return figure


def _geometry_figure(result: CalibrationResult) -> Figure:
    """Draw where the dots were, from the side and over the sensor, coloured by distance."""
    from matplotlib.figure import Figure

    used = np.array([o.reason is None for o in result.observations])
    depth = _depths(result)
    figure = Figure(figsize=(8.5, 3.2), layout="constrained")
    side, sensor = figure.subplots(1, 2)
    if len(result.dots_mm):
        across = result.dots_mm[:, 0]
        side.scatter(across[used], result.dots_mm[used, 2], s=4, c=depth[used], cmap="viridis")
        side.scatter(across[~used], result.dots_mm[~used, 2], s=14, c="red", marker="x")
    side.plot(*result.camera[[7, 9]], "k^", markersize=7)
    side.set_xlabel("x of the taper, mm (triangle: camera; red: left out)")
    side.set_ylabel("z of the taper, mm")
    at = np.array([o.pixel for o in result.observations])
    drawn = sensor.scatter(*at[used].T, s=5, c=depth[used], cmap="viridis")
    sensor.scatter(*at[~used].T, s=14, c="red", marker="x")
    figure.colorbar(drawn, ax=sensor, label="distance, mm")
    _as_sensor(sensor, result)
    return figure


def _depths(result: CalibrationResult) -> np.ndarray:
    if not len(result.dots_mm):
        return np.zeros(len(result.observations))
    axis = rotation_from_euler_xyz_rad(*result.camera[10:])[:, 2]
    return np.asarray((result.dots_mm - result.camera[7:10]) @ axis)
