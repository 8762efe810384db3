"""What a solution tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.machine_noise import MachineNoise
from omm_core.part_pose.observation import Observation
from omm_core.part_pose.posterior import PoseStatement
from omm_core.part_pose.statistics import Statistics
from omm_core.words import Words

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """The result of :func:`solve`.

    Attributes
    ----------
    model : str
        "7d" or "6d".
    determined : bool
        Where False, theta and covariance are NaN and ``missing`` says why.
    own : PoseStatement
        In the machine's own coordinates (noise_model.py): what alignment and hand-over need.
    absolute : PoseStatement
        In ideal coordinates: believable where the machine's geometry is declared.
    geometry_declared : bool
        Whether it is.
    machine : MachineNoise or None
        How exact the machine is, as declared or as the run shows; None where not determined.
    covariance_factor : float
        What the covariances were multiplied with: above 1 where the residuals are larger than the
        declared machine explains.
    shares : dict of (7,) arrays
        Fraction of each parameter's variance by source; they sum to 1.
    observations : tuple of Observation
        All, in the order (stamp, target).
    used : (N,) bool array
    reasons : tuple of str or None
        Why an observation was not used.
    residuals_px : (N, 2) array
        Computed minus measured, also of those not used.
    statistics : Statistics or None
        Of the observations used, in their order.
    missing, poor, findings, remarks : tuples of str
        What is not determined; what is determined poorly; what was found wrong; what else a person
        should know.
    """

    model: str
    determined: bool
    converged: bool
    iterations: int
    own: PoseStatement
    absolute: PoseStatement
    geometry_declared: bool
    machine: MachineNoise | None
    covariance_factor: float
    shares: dict[str, Array]
    rms_px: float
    observations: tuple[Observation, ...]
    used: NDArray[np.bool_]
    reasons: tuple[Words | None, ...]
    residuals_px: Array
    statistics: Statistics | None
    missing: tuple[Words, ...]
    poor: tuple[Words, ...]
    findings: tuple[Words, ...]
    remarks: tuple[Words, ...]

    @property
    def theta(self) -> Array:
        """Return (α, β, γ, x, y, z, γ_s), rad and mm, in the machine's own coordinates."""
        return self.own.theta

    @property
    def covariance(self) -> Array:
        """Return the covariance of theta, (7, 7). In 6D the row and column of γ_s are zero."""
        return self.own.covariance

    @property
    def expanded_uncertainty(self) -> Array:
        """Return U of theta, (7,): 95.45 % of errors are smaller, whatever the distribution."""
        return self.own.expanded_uncertainty

    @property
    def sigma0(self) -> float:
        """Square root of the cost by the degrees of freedom; NaN without redundancy."""
        return self.statistics.sigma0 if self.statistics is not None else float("nan")

    @property
    def degrees_of_freedom(self) -> int:
        """Coordinates measured minus unknowns."""
        return self.statistics.degrees_of_freedom if self.statistics is not None else 0
