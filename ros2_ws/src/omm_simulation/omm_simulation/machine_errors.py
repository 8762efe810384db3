"""How a simulated machine, its part and its camera err: what a scenario says, and what is drawn.

A scenario declares sizes (`MachineErrors`); `draw_errors` makes one machine of them. The statistics
are those of `omm_core.machine_errors`. Nodes never hear of it: the control reports what its scales
see, and the estimator gets the part and the camera as their files have them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.declared import number, truth, values
from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.machine_errors import (
    GeometryField,
    draw_calibration,
    draw_targets,
    thermally_expanded,
)

Floats = NDArray[np.float64]
Vector = Annotated[tuple[float, float, float], values(3)]


@dataclass(frozen=True, kw_only=True)
class MachineErrors:
    """How large the errors are; left out, there are none.

    Attributes
    ----------
    stop_sigma_mm : float
        Standard deviation of each axis, each stop anew.
    geometry_sigma_mm, geometry_length_mm : float
        Errors that vary smoothly: covariance σ² exp(-d²/2l²) between commanded places d apart.
    lost_motion_mm : tuple
        X, Y, Z: difference between coming to a place from either side.
    spindle_drift_mm : tuple
        Where warming up moves the spindle in the end, machine frame; it begins with the program.
    spindle_drift_s : float
        Its time constant.
    holder_sigma_mm : tuple
        How repeatably the holder seats in the spindle, x, y, z of the spindle; each clamping anew.
    part_warmth_K : float
        The part is up to so much warmer or colder (uniform) than when it was surveyed.
    part_expansion_per_K : float
        Of the part, about its origin.
    targets_err, calibration_errs : bool
        Whether targets and camera are off their files by what these declare.
    """

    stop_sigma_mm: Annotated[float, number()] = 0.0
    geometry_sigma_mm: Annotated[float, number()] = 0.0
    geometry_length_mm: Annotated[float, number()] = 1000.0
    lost_motion_mm: Vector = (0.0, 0.0, 0.0)
    spindle_drift_mm: Vector = (0.0, 0.0, 0.0)
    spindle_drift_s: Annotated[float, number()] = 1800.0
    holder_sigma_mm: Vector = (0.0, 0.0, 0.0)
    part_warmth_K: Annotated[float, number()] = 0.0
    part_expansion_per_K: Annotated[float, number()] = 11e-6
    targets_err: Annotated[bool, truth()] = False
    calibration_errs: Annotated[bool, truth()] = False

    def __post_init__(self) -> None:
        sizes = (
            self.stop_sigma_mm, self.geometry_sigma_mm, self.part_warmth_K, *self.lost_motion_mm,
            *self.holder_sigma_mm,
        )  # fmt: skip
        if min(sizes) < 0.0 or self.geometry_length_mm <= 0.0 or self.spindle_drift_s <= 0.0:
            raise InputError(
                "Expected errors >= 0, with geometry_length_mm and spindle_drift_s > 0, got"
                f" {self}."
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnErrors:
    """One machine, on one day.

    Attributes
    ----------
    geometry : GeometryField or None
        None where the machine's geometry is exact.
    part_warmth_K : float
        How much warmer the part is than when it was surveyed.
    """

    geometry: GeometryField | None = None
    part_warmth_K: float = 0.0

    def geometry_mm(self, places_mm: Floats) -> Floats:
        """Return the geometry's error (true minus commanded) at places (..., 3)."""
        if self.geometry is None:
            return np.zeros_like(np.asarray(places_mm, dtype=float))
        return self.geometry(places_mm)


def draw_errors(declared: MachineErrors, random: np.random.Generator) -> DrawnErrors:
    """Draw a machine."""
    field = GeometryField.draw(random, declared.geometry_sigma_mm, declared.geometry_length_mm)
    return DrawnErrors(
        geometry=field if declared.geometry_sigma_mm > 0.0 else None,
        part_warmth_K=float(random.uniform(-1.0, 1.0)) * declared.part_warmth_K,
    )


def draw_true_part(
    part: Part, declared: MachineErrors, drawn: DrawnErrors, random: np.random.Generator
) -> Part:
    """Return the part as it is: targets off what the file says, and all of it warmer or colder."""
    true = draw_targets(random, part) if declared.targets_err else part
    if drawn.part_warmth_K == 0.0:
        return true
    grown = [
        replace(
            t,
            xyz_mm=thermally_expanded(t.xyz_mm, drawn.part_warmth_K, declared.part_expansion_per_K),
        )
        for t in true.targets
    ]
    return replace(true, targets=tuple(grown))


def draw_true_calibration(
    calibration: CameraCalibration,
    declared: MachineErrors,
    random: np.random.Generator,
    clamping: np.random.Generator,
) -> CameraCalibration:
    """Return the camera as it is, in a holder that has seated a little off.

    The covariance that a file declares is of the camera as clamped: the seat is in it, and what is
    left of it is the calibration's.
    """
    sigma_mm = np.array(declared.holder_sigma_mm)
    true = calibration
    if declared.calibration_errs:
        true = draw_calibration(random, _without_seat(calibration, sigma_mm))
    seat_mm = clamping.normal(0.0, 1.0, 3) * sigma_mm
    if not seat_mm.any():
        return true
    pose = true.taper_T_camera
    return replace(
        true,
        taper_T_camera=RigidTransform(
            rotation=pose.rotation, translation_mm=pose.translation_mm + seat_mm
        ),
    )


def _without_seat(calibration: CameraCalibration, sigma_mm: Floats) -> CameraCalibration:
    covariance = calibration.covariance.copy()
    for name, sigma in zip(("x_mm", "y_mm", "z_mm"), sigma_mm):
        if name in calibration.parameters:
            k = calibration.parameters.index(name)
            covariance[k, k] -= min(sigma**2, covariance[k, k])
    return replace(calibration, covariance=covariance)
