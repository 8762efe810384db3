"""One target seen in one image, by place and size, and what would be seen of it elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform, spindle_T_taper
from omm_core.planning.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictedSighting:
    """A target (its row in the part) in an image."""

    machine_T_spindle: RigidTransform
    row: int
    center_px: Array
    diameter_px: float


def predicted_sightings(
    scene: Scene, gamma_s_rad: float, sightings: Sequence[PredictedSighting]
) -> tuple[Array, Array]:
    """Return centres (N, 2) and diameters (N,) in px; NaN where the lens does not see a target.

    The centre is the mean of the outline, which is within a tenth of a pixel of the ellipse's.
    """
    held = spindle_T_taper(gamma_s_rad) @ scene.calibration.taper_T_camera
    outlines = scene.machine_T_part @ scene.circles(1.0)
    points = np.array(
        [
            (sighting.machine_T_spindle @ held).inverse() @ outlines[sighting.row]
            for sighting in sightings
        ]
    )
    pixels = scene.calibration.lens.project(points.reshape(-1, 3)).reshape(-1, 8, 2)
    centred = pixels - pixels.mean(axis=1, keepdims=True)
    # Σ p pᵀ = 4 T Tᵀ with T the ellipse's half axes as columns; its area is π det T.
    moment = np.einsum("nki,nkj->nij", centred, centred) / 4.0
    determinant = moment[:, 0, 0] * moment[:, 1, 1] - moment[:, 0, 1] ** 2
    # Without a normal all points are the centre: the size tells nothing then.
    size = np.where(determinant > 0.0, determinant, np.nan) ** 0.25
    told = np.array([sighting.diameter_px for sighting in sightings])
    degenerate = np.isfinite(pixels[:, 0, 0]) & ~(determinant > 1e-12)
    return pixels.mean(axis=1), np.where(degenerate, told, 2.0 * size)
