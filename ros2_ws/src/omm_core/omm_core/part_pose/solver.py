"""From observations to a solution that can be believed, or to words for why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Part
from omm_core.imaging.calibration import CameraCalibration
from omm_core.part_pose.adjustment import adjust, predictions
from omm_core.part_pose.fit import Fit
from omm_core.part_pose.naming import MIRRORED, all_wrong, cannot_tell
from omm_core.part_pose.problem import Observation, Problem, SolveOptions, build_problem
from omm_core.part_pose.snooping import Search, search
from omm_core.part_pose.statistics import Statistics

Array = NDArray[np.float64]

_CONTRADICTION_PX = 2.0  # residuals that no underestimated noise explains
_CONTRADICTION_SIGMA0 = 30.0
_ENOUGH_TO_JUDGE = 3  # degrees of freedom from which σ0 tells more than that something is wrong


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """The result of :func:`solve`.

    Attributes
    ----------
    model : str
        "7d" or "6d".
    determined : bool
        Where False, theta and covariance are NaN and ``missing`` says why.
    theta : (7,) array
        (α, β, γ, x, y, z, γ_s), rad and mm.
    covariance : (7, 7) array
        In the order of theta. In 6D the row and column of γ_s are zero.
    covariance_factor : float
        What the covariance was multiplied with: above 1 where the residuals are larger than all
        known uncertainty explains.
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
    missing, poor, findings : tuples of str
        What is not determined; what is determined poorly; what was found wrong.
    """

    model: str
    determined: bool
    converged: bool
    iterations: int
    theta: Array
    covariance: Array
    covariance_factor: float
    shares: dict[str, Array]
    rms_px: float
    observations: tuple[Observation, ...]
    used: NDArray[np.bool_]
    reasons: tuple[str | None, ...]
    residuals_px: Array
    statistics: Statistics | None
    missing: tuple[str, ...]
    poor: tuple[str, ...]
    findings: tuple[str, ...]

    @property
    def sigma0(self) -> float:
        """Square root of the cost by the degrees of freedom; NaN without redundancy."""
        return self.statistics.sigma0 if self.statistics is not None else float("nan")

    @property
    def degrees_of_freedom(self) -> int:
        """Coordinates measured minus unknowns."""
        return self.statistics.degrees_of_freedom if self.statistics is not None else 0


def solve(
    observations: Sequence[Observation],
    part: Part,
    calibration: CameraCalibration,
    options: SolveOptions | None = None,
) -> Solution:
    """Solve the 7D (or 6D) problem from nothing.

    Parameters
    ----------
    observations : sequence of Observation
        In any order; the result does not depend on it.
    part, calibration
        What is known.
    options : SolveOptions
        How to solve.

    Raises
    ------
    InputError
        Where an observation is malformed, or of a target that the part does not have.
    """
    options = options or SolveOptions()
    problem = build_problem(observations, part, calibration, options.circle_centre)
    found = search(problem, options)
    found = _judge_contradiction(problem, found, options)
    return _solution(problem, found, options)


def _judge_contradiction(problem: Problem, found: Search, options: SolveOptions) -> Search:
    """Refuse residuals that no noise explains; smaller ones enlarge the covariance."""
    propagation, statistics = found.fit.propagation, found.fit.statistics
    if propagation is None or statistics is None or statistics.passed or not options.find_errors:
        return found
    rms_px = _rms(propagation.raw_residuals_px)
    noise = rms_px < _CONTRADICTION_PX and statistics.sigma0 < _CONTRADICTION_SIGMA0
    if noise and statistics.degrees_of_freedom >= _ENOUGH_TO_JUDGE:
        return found
    if statistics.degrees_of_freedom < _ENOUGH_TO_JUDGE:
        words = cannot_tell(statistics.sigma0)
        return replace(found, fit=replace(found.fit, missing=(*found.fit.missing, words)))
    words = MIRRORED if _fits_mirrored(problem, options, rms_px) else all_wrong(problem, rms_px)
    return replace(found, fit=replace(found.fit, missing=(*found.fit.missing, words)))


def _fits_mirrored(problem: Problem, options: SolveOptions, rms_px: float) -> bool:
    mirrored = problem.measured.copy()
    mirrored[:, 0] = problem.calibration.width_px - 1 - mirrored[:, 0]
    other = replace(problem, measured=mirrored)
    minima = adjust(other, options)
    if not minima:
        return False
    residuals = predictions(other, minima[0])[0] - mirrored
    return _rms(residuals) < min(_CONTRADICTION_PX, rms_px / 10)


def _solution(problem: Problem, found: Search, options: SolveOptions) -> Solution:
    fit = found.fit
    theta, covariance = np.full(7, np.nan), np.full((7, 7), np.nan)
    shares: dict[str, Array] = {}
    factor, findings = 1.0, list(found.findings)
    residuals = np.full((len(problem), 2), np.nan)
    if fit.best is not None:
        residuals = predictions(problem, fit.best)[0] - problem.measured
    if fit.determined and fit.best is not None and fit.propagation is not None:
        theta = fit.best.theta(problem.X0_mm)
        to_theta = fit.best.d_theta_d_local(problem.X0_mm)
        covariance = to_theta @ fit.propagation.covariance @ to_theta.T
        variances = {
            name: np.diag(to_theta @ share @ to_theta.T)
            for name, share in fit.propagation.shares.items()
        }
        total = np.where(np.diag(covariance) > 0, np.diag(covariance), 1.0)
        shares = {name: variance / total for name, variance in variances.items()}
        factor = _factor(fit)
        covariance = covariance * factor
        if factor > 1.0:
            findings.append(
                f"the residuals are {np.sqrt(factor):.1f} times larger than the known"
                " uncertainties explain, and no single image or target stands out: the covariance"
                f" is enlarged by {factor:.1f} (set machine_sigma_mm, or sigma_xyz_mm of the"
                " targets?)"
            )
    return Solution(
        model=options.model,
        determined=fit.determined,
        converged=fit.determined and fit.best is not None and fit.best.converged,
        iterations=fit.best.iterations if fit.best is not None else 0,
        theta=theta,
        covariance=covariance,
        covariance_factor=factor,
        shares=shares,
        rms_px=_rms(residuals[~found.dropped]),
        observations=problem.observations,
        used=~found.dropped if fit.determined else np.zeros(len(problem), dtype=bool),
        reasons=tuple(found.reasons.get(index) for index in range(len(problem))),
        residuals_px=residuals,
        statistics=fit.statistics,
        missing=fit.missing,
        poor=fit.poor,
        findings=tuple(findings),
    )


def _factor(fit: Fit) -> float:
    """Return what the covariance must be multiplied with to agree with the residuals."""
    statistics = fit.statistics
    if statistics is None or statistics.passed or statistics.degrees_of_freedom < 1:
        return 1.0
    return max(1.0, statistics.sigma0**2)


def _rms(residuals_px: Array) -> float:
    """Return sqrt(mean(dcol² + drow²) / 2): per coordinate, NaN where there is none."""
    return float(np.sqrt(np.mean(residuals_px**2))) if residuals_px.size else float("nan")
