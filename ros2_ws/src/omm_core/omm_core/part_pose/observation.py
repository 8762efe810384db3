"""What is given to a solution: targets in images, and how to solve."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.machine import MachineUncertainty
from omm_core.geometry import RigidTransform
from omm_core.imaging.circle import CircleCentre

Array = NDArray[np.float64]


Model = Literal["7d", "6d"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Observation:
    """One target seen in one image.

    Attributes
    ----------
    stamp_ns : int
        Of the image; observations of one stamp belong to one image.
    target_id : int
        Number in the target family.
    center_px : (2,) array
        (col, row) of the centre of the dot's image.
    covariance_px2 : (2, 2) array
        Of ``center_px``.
    machine_T_spindle : RigidTransform
        Pose of the spindle when the image was taken.
    """

    stamp_ns: int
    target_id: int
    center_px: Array
    covariance_px2: Array
    machine_T_spindle: RigidTransform


@dataclass(frozen=True, kw_only=True)
class SolveOptions:
    """How to solve.

    Attributes
    ----------
    model : "7d" or "6d"
        In 6D γ_s is given.
    gamma_s_rad : float
        γ_s of the 6D model.
    stop_sigma_mm, geometry_sigma_mm, geometry_length_mm : float or None
        How exact the machine is, as in machine.yaml (files/machine.py); None: estimated from the
        run; all 0: without errors.
    worst_machine_mm : float
        No machine's geometry errs by more (standard deviation; its stops by a quarter of that):
        residuals that need more are a contradiction, not noise.
    trust_detector : bool
        Whether the centres are as exact as the detector says; else, where images show several
        targets, they may be worse.
    use_target_sigma, use_calibration_covariance : bool
        Whether what the files tell of their own uncertainty is taken into account.
    circle_centre : CircleCentre
        Which centre of the dot's image was measured.
    significance : float
        Error probability of the tests for wrong observations.
    find_errors : bool
        Whether wrong observations are searched for and left out.
    """

    model: Model = "7d"
    gamma_s_rad: float = 0.0
    stop_sigma_mm: float | None = None
    geometry_sigma_mm: float | None = None
    geometry_length_mm: float | None = None
    worst_machine_mm: float = 0.1
    trust_detector: bool = False
    use_target_sigma: bool = True
    use_calibration_covariance: bool = True
    circle_centre: CircleCentre = CircleCentre.OUTLINE
    significance: float = 0.001
    find_errors: bool = True

    def __post_init__(self) -> None:
        if self.model not in ("7d", "6d"):
            raise InputError(f"Expected the model '7d' or '6d', got {self.model!r}.")
        for name in ("stop_sigma_mm", "geometry_sigma_mm"):
            sigma = getattr(self, name)
            if sigma is not None and not (np.isfinite(sigma) and sigma >= 0.0):
                raise InputError(f"Expected {name} >= 0, got {sigma}.")
        for name in ("geometry_length_mm", "worst_machine_mm"):
            length = getattr(self, name)
            if length is not None and not (np.isfinite(length) and length > 0.0):
                raise InputError(f"Expected {name} > 0, got {length}.")
        if not np.isfinite(self.gamma_s_rad):
            raise InputError(f"Expected a finite gamma_s_rad, got {self.gamma_s_rad}.")

    @property
    def unknowns(self) -> int:
        """7 or 6."""
        return 7 if self.model == "7d" else 6

    def of_machine(self, declared: MachineUncertainty) -> SolveOptions:
        """Return the same for a machine of which something is declared; what is set here stays."""
        return replace(
            self,
            **{
                field.name: getattr(declared, field.name)
                for field in fields(declared)
                if getattr(self, field.name) is None
            },
        )
