"""What a calibration ends in, and whether it can be believed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Solution
from omm_core.camera_calibration.model import PARAMETERS, Sensor, project_with_derivatives
from omm_core.errors import MeasurementError
from omm_core.geometry import rotation_from_euler_xyz_rad

Array = NDArray[np.float64]

DISTANCES_MM = (150.0, 300.0, 500.0)
# A camera whose projection is not known to this is none.
LARGEST_SIGMA_PX = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class DotObservation:
    """One image of one dot: measured, and predicted minus measured (as solve tells it)."""

    image: str
    pixel: Array
    residual_px: Array
    reason: str | None = None
    target_id: int | None = None

    def to_json_dict(self) -> dict[str, Any]:
        """Return it as the contract has it."""
        identity = {} if self.target_id is None else {"target_id": self.target_id}
        residual = [float(v) for v in self.residual_px]
        return {
            "image": self.image,
            **identity,
            "col_px": float(self.pixel[0]),
            "row_px": float(self.pixel[1]),
            "residual_px": residual if np.isfinite(residual).all() else None,
            "used": self.reason is None,
            "reason": self.reason,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationResult:
    """A camera with the covariance of its 13 parameters, and how it was found.

    ``covered_mm`` is the range of distances before the camera at which dots were seen;
    ``undetermined`` names parameters about which the set says nothing; ``dots_mm`` (N, 3) is where
    each observation's dot was, taper frame (empty where not told).
    """

    sensor: Sensor
    camera: Array
    covariance: Array
    sigma0: float
    degrees_of_freedom: int
    converged: bool
    observations: tuple[DotObservation, ...]
    images: int
    covered_mm: tuple[float, float]
    findings: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    extra: dict[str, Any] = field(default_factory=dict)
    dots_mm: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def rms_px(self) -> float:
        """Root mean square of all used residuals, each of col and row counted."""
        used = [o.residual_px for o in self.observations if o.reason is None]
        return float(np.sqrt(np.mean(np.square(used))))

    @property
    def covered_px(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The box of the image in which dots were used: (col, row) of its corners."""
        pixels = np.array([o.pixel for o in self.observations if o.reason is None])
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))

    def to_json_dict(self) -> dict[str, Any]:
        """Return ``calibrate --json`` (contract)."""
        return {
            "converged": self.converged,
            "parameters": list(PARAMETERS),
            "values": [float(v) for v in self.camera],
            "covariance": self.covariance.tolist(),
            "rms_px": self.rms_px,
            "sigma0": self.sigma0,
            "degrees_of_freedom": self.degrees_of_freedom,
            "findings": list(self.findings),
            "extra": {"undetermined": list(self.undetermined), **self.extra},
            "observations": [o.to_json_dict() for o in self.observations],
        }


def projection_sigma_px(
    sensor: Sensor, camera: Array, covariance: Array, distance_mm: float, steps: int = 7
) -> Array:
    """Return the uncertainty of where a point appears, over the image at one distance.

    Parameters
    ----------
    sensor, camera, covariance
        The camera (13,) and its covariance (13, 13).
    distance_mm : float
        Depth of the points before the camera.
    steps : int
        Points along each side of the image.

    Returns
    -------
    (steps, steps) array
        Root of the larger eigenvalue of each point's covariance, px; rows run along the image's.
    """
    lens = sensor.lens(camera)
    rays = lens.rays(lens.pixel_grid(steps)) * distance_mm
    rotation = rotation_from_euler_xyz_rad(*camera[10:])
    points = rays @ rotation.T + camera[7:10]
    by_camera = project_with_derivatives(sensor, camera, points[:, None])[1]
    spread = by_camera @ covariance @ np.swapaxes(by_camera, 1, 2)
    return np.sqrt(np.linalg.eigvalsh(spread)[:, -1].clip(0.0)).reshape(steps, steps)


def require_determined(sensor: Sensor, solution: Solution) -> None:
    """Raise MeasurementError where a set says too little about the camera."""
    camera, covariance = solution.values["camera"][0], solution.covariance_of("camera")
    if solution.undetermined:
        words = "; ".join(", ".join(u.labels[:6]) for u in solution.undetermined)
        raise MeasurementError(
            f"The set leaves {len(solution.undetermined)} directions of the camera open: {words}. "
            "Spread the dots over the whole image and over several distances."
        )
    if not solution.converged:
        raise MeasurementError(
            "The adjustment does not converge: no camera fits the set. Check which image belongs "
            "to which place, the axes of the places and the size of the sensor."
        )
    worst = max(projection_sigma_px(sensor, camera, covariance, d).max() for d in DISTANCES_MM)
    if worst > LARGEST_SIGMA_PX:
        scaled = np.sqrt(np.diag(covariance)) / _SIZES
        order = [PARAMETERS[i] for i in np.argsort(-scaled)[:5]]
        raise MeasurementError(
            f"The set says too little about the camera: where a point appears would be known to "
            f"{worst:.0f} px only (open most of all: {', '.join(order)}). Spread the dots over the "
            "whole image and over several distances."
        )


# What each parameter may be in size, to compare how open they are.
_SIZES = np.array([1.0, 100, 100, 1e-8, 1e-15, 1e-7, 1e-7, 10, 10, 10, 0.01, 0.01, 0.01])
