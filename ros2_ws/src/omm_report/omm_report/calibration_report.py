"""A calibration as a document: parameters, residuals, where it can be believed, correlations."""

from __future__ import annotations

import json

import numpy as np

from omm_core.camera_calibration.model import PARAMETERS
from omm_core.camera_calibration.result import CalibrationResult
from omm_report.calibration_figures import calibration_figures
from omm_report.calibration_text import result_sigma_words
from omm_report.document import Document


def calibration_document(result: CalibrationResult, source: str) -> bytes:
    """Return the PDF of a calibration.

    Parameters
    ----------
    result : CalibrationResult
    source : str
        The set, as people named it.
    """
    near, far = result.covered_mm
    figures = calibration_figures(result)
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
    document.figure(figures["projection"]())
    document.heading("What it allows of a measurement")
    document.paragraph(result_sigma_words(result))
    document.heading("Geometry of the set")
    document.figure(figures["geometry"]())
    document.heading("Residuals")
    document.figure(figures["residuals"](), caption="Predicted minus measured.", width_mm=140)
    document.heading("Distortion")
    document.figure(
        figures["distortion"](), caption="Measured to ideal, enlarged 10 times.", width_mm=140
    )
    document.heading("Correlations")
    document.paragraph(
        "beta with cl0 and alpha with rw0 are always strongly correlated; that is harmless."
    )
    document.figure(figures["correlations"](), width_mm=130.0)
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
