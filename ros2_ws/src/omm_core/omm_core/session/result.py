"""The result of a measurement, with every image and every target accounted for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose import THETA_NAMES, Solution
from omm_core.part_pose.machine_noise import MachineNoise
from omm_core.words import Words


@dataclass(frozen=True, kw_only=True)
class ImageOutcome:
    """What became of one image; ``pending``: it still waits for spindle poses after it."""

    stamp_ns: int
    used: bool
    reason: Words | None
    pending: bool = False


@dataclass(frozen=True, kw_only=True)
class ObservationOutcome:
    """What became of one target that was found in one image.

    Attributes
    ----------
    residual_px : (2,) tuple
        Computed minus measured (col, row); NaN where nothing could be computed.
    redundancy, w_test, smallest_detectable_px : float
        See `part_pose.statistics`; NaN where not used.
    """

    stamp_ns: int
    target_id: int
    center_px: tuple[float, float]
    residual_px: tuple[float, float]
    used: bool
    reason: Words | None
    redundancy: float = math.nan
    w_test: float = math.nan
    smallest_detectable_px: float = math.nan
    external_sigma: float = math.nan


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasurementResult:
    """A solution with what led to it.

    Attributes
    ----------
    part_name : str
    solution : Solution
    images : tuple of ImageOutcome
        By stamp.
    observations : tuple of ObservationOutcome
        By stamp and target.
    images_per_target : dict
        For every target of the part: in how many used images it was seen.
    """

    part_name: str
    solution: Solution
    images: tuple[ImageOutcome, ...]
    observations: tuple[ObservationOutcome, ...]
    images_per_target: dict[int, int]
    findings: tuple[Words, ...]
    missing: tuple[Words, ...]

    @property
    def determined(self) -> bool:
        """Whether there is an estimate to believe."""
        return self.solution.determined

    @property
    def images_pending(self) -> int:
        """Images that still wait for spindle poses after them."""
        return sum(image.pending for image in self.images)

    def to_json_dict(self) -> dict[str, Any]:
        """Return what ``solve --json`` writes (contract.md); null where there is no number."""
        solution = self.solution
        return {
            "model": solution.model,
            "converged": solution.converged,
            "theta": {n: _number(v) for n, v in zip(THETA_NAMES, solution.theta)},
            "covariance": _matrix(solution.covariance),
            "expanded_uncertainty": [_number(v) for v in solution.expanded_uncertainty],
            "absolute": {
                "theta": {n: _number(v) for n, v in zip(THETA_NAMES, solution.absolute.theta)},
                "covariance": _matrix(solution.absolute.covariance),
                "expanded_uncertainty": [
                    _number(v) for v in solution.absolute.expanded_uncertainty
                ],
                "declared": solution.geometry_declared,
            },
            "machine": _machine_dict(solution.machine),
            "rms_px": _number(solution.rms_px),
            "sigma0": _number(solution.sigma0),
            "degrees_of_freedom": int(solution.degrees_of_freedom),
            "images": [
                {"stamp_ns": image.stamp_ns, "used": image.used, "reason": image.reason}
                for image in self.images
            ],
            "observations": [_observation_dict(outcome) for outcome in self.observations],
            "part": self.part_name,
            "determined": solution.determined,
            "missing": list(self.missing),
            "poorly_determined": list(solution.poor),
            "findings": list(self.findings),
            "remarks": list(solution.remarks),
            "statistics": _statistics_dict(solution),
            "variance_shares": {
                source: {n: _number(v) for n, v in zip(THETA_NAMES, share)}
                for source, share in solution.shares.items()
            },
            "images_per_target": {str(k): v for k, v in self.images_per_target.items()},
        }


def _matrix(values: NDArray[np.float64]) -> list[list[float | None]]:
    return [[_number(v) for v in row] for row in values]


def _machine_dict(noise: MachineNoise | None) -> dict[str, Any] | None:
    """Return the machine's noise: medians, and what holds 90 % of each one's probability."""
    if noise is None:
        return None
    levels = {
        name: getattr(noise, name)
        for name in ("stop_sigma_mm", "geometry_sigma_mm", "geometry_length_mm")
    }
    return {
        **{name: level.median for name, level in levels.items()},
        "estimated": list(noise.estimated),
        "ranges": {name: [level.low, level.high] for name, level in levels.items()},
        "image_scale": noise.image_scale,
    }


def _observation_dict(outcome: ObservationOutcome) -> dict[str, Any]:
    return {
        "stamp_ns": outcome.stamp_ns,
        "target_id": outcome.target_id,
        "col_px": _number(outcome.center_px[0]),
        "row_px": _number(outcome.center_px[1]),
        "residual_px": [_number(value) for value in outcome.residual_px],
        "used": outcome.used,
        "reason": outcome.reason,
        "redundancy": _number(outcome.redundancy),
        "w_test": _number(outcome.w_test),
        "smallest_detectable_px": _number(outcome.smallest_detectable_px),
        "external_reliability_sigma": _number(outcome.external_sigma),
    }


def _statistics_dict(solution: Solution) -> dict[str, Any] | None:
    statistics = solution.statistics
    if statistics is None:
        return None
    return {
        "global_test": _number(statistics.global_test),
        "global_limit": _number(statistics.global_limit),
        "passed": statistics.passed,
        "w_limit": _number(statistics.w_limit),
        "covariance_factor": _number(solution.covariance_factor),
    }


def _number(value: float | np.floating[Any]) -> float | None:
    """Return a number that JSON has, else None."""
    return float(value) if math.isfinite(value) else None
