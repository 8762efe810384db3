"""A calibration as a document: parameters, residuals, where it can be believed, correlations."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from omm_core.camera_calibration.model import PARAMETERS
from omm_core.camera_calibration.result import (
    DISTANCES_MM,
    CalibrationResult,
    projection_sigma_px,
)
from omm_report.document import Document

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def calibration_document(result: CalibrationResult, source: str) -> bytes:
    """Return the PDF of a calibration.

    Parameters
    ----------
    result : CalibrationResult
    source : str
        The set, as people named it.
    """
    near, far = result.covered_mm
    document = Document(f"Calibration of {result.sensor.name}")
    document.paragraph(
        f"From {source}: {result.images} images, {len(result.observations)} dots, "
        f"{near:.0f} to {far:.0f} mm before the camera.\n"
        f"Residuals {result.rms_px:.4f} px rms; sigma0 {result.sigma0:.3f} with "
        f"{result.degrees_of_freedom} degrees of freedom."
    )
    for words in result.findings:
        document.paragraph(f"Finding: {words}.")
    document.heading("Parameters")
    document.table(_parameter_rows(result))
    document.heading("Where a point appears is known to")
    document.paragraph(
        "Standard deviation over the image, px: the larger axis of its ellipse. Distances that the "
        "set does not cover are extrapolated."
    )
    document.figure(_projection_figure(result))
    document.heading("Residuals")
    document.figure(_residual_figure(result), caption="Predicted minus measured, enlarged.")
    document.heading("Distortion")
    document.figure(_distortion_figure(result), caption="Measured to ideal, enlarged 10 times.")
    document.heading("Correlations")
    document.paragraph(
        "beta with cl0 and alpha with rw0 are always strongly correlated; that is harmless."
    )
    document.figure(_correlation_figure(result), width_mm=130.0)
    document.attach(
        "calibration.json",
        json.dumps(result.to_json_dict(), allow_nan=False).encode(),
        description="the result as written by --json",
        mime_type="application/json",
    )
    return document.to_bytes()


def _parameter_rows(result: CalibrationResult) -> list[list[str]]:
    rows = [["parameter", "value", "σ", "U (k = 2)"]]
    sigmas = np.sqrt(np.diag(result.covariance))
    for name, value, sigma in zip(PARAMETERS, result.camera, sigmas, strict=True):
        note = " undetermined, assumed" if name in result.undetermined else ""
        rows.append([name, f"{value:.9g}", f"{sigma:.3g}{note}", f"{2 * sigma:.3g}"])
    return rows


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
    scale = max(result.rms_px, 1e-9) / (0.02 * result.sensor.width_px)
    arrows = axes.quiver(
        *at.T, *residual.T, angles="xy", scale_units="xy", scale=scale, width=0.0015
    )
    axes.quiverkey(arrows, 0.85, 1.03, result.rms_px, f"{result.rms_px:.4f} px", labelpos="E")
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
