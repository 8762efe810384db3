"""What ``./omm calibrate`` prints."""

import numpy as np

from omm_core.camera_calibration.model import PARAMETERS
from omm_core.camera_calibration.result import (
    DISTANCES_MM,
    CalibrationResult,
    projection_sigma_px,
)
from omm_core.camera_calibration.seven import DISTANCE_MM as RESULT_DISTANCE_MM
from omm_core.camera_calibration.seven import result_sigma


def calibration_lines(result: CalibrationResult) -> list[str]:
    """Return the lines that people read: parameters, fit, projection uncertainty, findings."""
    sigma = np.sqrt(np.diag(result.covariance))
    lines = [f"{result.sensor.name}: {result.images} images, {len(result.observations)} dots"]
    lines.append(f"  {'parameter':<16} {'value':>16} {'sigma':>12}")
    for name, value, s in zip(PARAMETERS, result.camera, sigma, strict=True):
        if name in result.undetermined:
            lines.append(f"  {name:<16} {value:>16.9g} undetermined; assumed within {s:.2g}")
        else:
            lines.append(f"  {name:<16} {value:>16.9g} {s:>12.3g}")
    lines.append(
        f"residuals {result.rms_px:.4f} px rms, sigma0 {result.sigma0:.3f}, "
        f"{result.degrees_of_freedom} degrees of freedom"
    )
    near, far = result.covered_mm
    lines.append(f"covered: {near:.0f} to {far:.0f} mm before the camera")
    lines.append("where a point appears is known to (sigma, px; middle and worst of the image):")
    for distance in DISTANCES_MM:
        spread = projection_sigma_px(result.sensor, result.camera, result.covariance, distance)
        beyond = "" if near <= distance <= far else "  (outside what the set covers)"
        middle = spread[len(spread) // 2, len(spread) // 2]
        lines.append(f"  {distance:>5.0f} mm  {middle:.4f}  {spread.max():.4f}{beyond}")
    lines.append(result_sigma_words(result))
    lines += [f"finding: {words}" for words in result.findings]
    return lines


def result_sigma_words(result: CalibrationResult) -> str:
    """Return what the camera's uncertainty alone does to a standard measurement (seven.py)."""
    sigma = result_sigma(result.sensor, result.camera, result.covariance)
    x, y, z = (f"{1000 * v:.2g}" for v in sigma[3:6])
    return (
        f"a part of 1 m measured from {RESULT_DISTANCE_MM:.0f} mm, by this camera alone (sigma): "
        f"x {x}, y {y}, z {z} µm, clamping angle {1e6 * sigma[6]:.2g} µrad; errors of the camera"
        " are the same at each target and turn nothing"
    )
