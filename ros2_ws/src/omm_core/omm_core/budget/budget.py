"""A budget as a whole: from contributions to U_OMM, U_total, capability and the worst point.

Paper eqs. 28 and 29: ``U_OMM = k √(u_ip² + u_it²)``, ``U_total = k √(u_out² + u_ip² + u_it²)``; the
machine's and all further contributors enter U_total, with their correlations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.budget_file import NamedPoint
from omm_core.budget.capability import Capability, capability, conformity, decide
from omm_core.budget.evaluation import (
    Combined,
    Contribution,
    Sampled,
    combine,
    root_sum_squares,
    sample,
)
from omm_core.budget.propagation import Correlation, student_factors

Array = NDArray[np.float64]
GROUPS = ("u_ip", "u_it", "u_out", "u_machine")


@dataclass(frozen=True, kw_only=True, eq=False)
class Coverage:
    """How U comes from u: by a factor, or by a probability and the degrees of freedom."""

    factor: float | None = 2.0
    probability: float | None = None

    def factors(self, combined: Combined) -> Array:
        """Return k for each point and axis, (P, 3)."""
        freedom = combined.degrees_of_freedom
        if self.probability is None:
            return np.full(freedom.shape, self.factor)
        return student_factors(self.probability, freedom)


@dataclass(frozen=True, kw_only=True, eq=False)
class Budget:
    """A budget at points; arrays are (P, 3), mm, machine X Y Z."""

    points: tuple[NamedPoint, ...]
    contributions: tuple[Contribution, ...]
    correlation: Correlation
    coverage: Coverage
    combined: Combined
    expanded_omm_mm: Array
    expanded_mm: Array
    sampled: Sampled
    tolerance_mm: float | None
    findings: tuple[str, ...] = ()

    @property
    def worst(self) -> tuple[int, int]:
        """Return the point and the axis of the largest U_total."""
        point, axis = np.unravel_index(int(np.argmax(self.expanded_mm)), self.expanded_mm.shape)
        return int(point), int(axis)

    def shares(self) -> dict[str, float]:
        """Return the parts of the variance at the worst point's worst axis; they sum to 1."""
        point, axis = self.worst
        found: dict[str, float] = {}
        for one in self.contributions:
            name = one.group if one.group in GROUPS else one.name
            found[name] = found.get(name, 0.0) + float(self.combined.shares[one.name][point, axis])
        return found

    def capability(self) -> Capability | None:
        """Return what the largest U_total of each axis means for the tolerance, if one is given."""
        if self.tolerance_mm is None:
            return None
        return capability(
            self.expanded_mm.max(axis=0),
            self.combined.standard_uncertainty_mm.max(axis=0),
            self.tolerance_mm,
        )

    def decision(self, index: int) -> tuple[list[float], list[str]] | None:
        """Return for a point's three deviations the probability to conform, and the decision.

        ISO 14253-1; None where no deviation was measured there, or no tolerance is given.
        """
        deviation = self.points[index].deviation_mm
        if deviation is None or self.tolerance_mm is None:
            return None
        pairs = list(zip(deviation.tolist(), self.combined.standard_uncertainty_mm[index].tolist()))
        return (
            [conformity(d, u, self.tolerance_mm) for d, u in pairs],
            [decide(d, u, self.tolerance_mm) for d, u in pairs],
        )

    def to_json_dict(self) -> dict[str, Any]:
        """Return what ``budget --json`` writes (contract.md)."""
        judged = self.capability()
        return {
            "points": [self._point_dict(index) for index in range(len(self.points))],
            "worst": self.points[self.worst[0]].name,
            "worst_axis": "XYZ"[self.worst[1]],
            "contributors": [
                {"name": name, "share": share} for name, share in self.shares().items()
            ],
            "capability": None if judged is None else _capability_dict(judged),
            "monte_carlo_trials": self.sampled.trials,
            "findings": list(self.findings),
        }

    def _point_dict(self, index: int) -> dict[str, Any]:
        columns = {
            f"{group}_mm": root_sum_squares(self.contributions, group)[index].tolist()
            for group in GROUPS
        }
        freedom = self.combined.degrees_of_freedom[index]
        return {
            "name": self.points[index].name,
            "xyz_mm": [float(v) for v in self.points[index].xyz_mm],
            **columns,
            "U_omm_mm": self.expanded_omm_mm[index].tolist(),
            "U_total_mm": self.expanded_mm[index].tolist(),
            "coverage_factor": self.coverage.factors(self.combined)[index].tolist(),
            "degrees_of_freedom": [float(v) if math.isfinite(v) else None for v in freedom],
            "monte_carlo": {
                "U_mm": self.sampled.half_width_mm[index].tolist(),
                "agrees": bool(self.sampled.agrees[index].all()),
            },
            **self._decision_dict(index),
        }

    def _decision_dict(self, index: int) -> dict[str, Any]:
        decided = self.decision(index)
        if decided is None:
            return {}
        deviation = self.points[index].deviation_mm
        assert deviation is not None  # else nothing were decided
        return {
            "iso_14253_1": {
                "deviation_mm": deviation.tolist(),
                "conformity_probability": decided[0],
                "decision": decided[1],
            }
        }


def evaluate(
    points: Sequence[NamedPoint],
    contributions: Sequence[Contribution],
    *,
    correlation: Correlation | None = None,
    coverage: Coverage | None = None,
    tolerance_mm: float | None = None,
    findings: Sequence[str] = (),
) -> Budget:
    """Evaluate a budget, by the GUM and by Monte Carlo."""
    coverage, correlation = coverage or Coverage(), correlation or {}
    combined = combine(contributions, correlation)
    in_machine = [c for c in contributions if c.group in ("u_ip", "u_it")]
    omm_mm = np.zeros_like(combined.standard_uncertainty_mm)
    if in_machine:
        omm = combine(in_machine, {})
        omm_mm = coverage.factors(omm) * omm.standard_uncertainty_mm
    return Budget(
        points=tuple(points),
        contributions=tuple(contributions),
        correlation=correlation,
        coverage=coverage,
        combined=combined,
        expanded_omm_mm=omm_mm,
        expanded_mm=coverage.factors(combined) * combined.standard_uncertainty_mm,
        sampled=sample(
            contributions,
            correlation,
            combined,
            by_degrees_of_freedom=coverage.probability is not None,
        ),
        tolerance_mm=tolerance_mm,
        findings=tuple(findings),
    )


def _capability_dict(judged: Capability) -> dict[str, Any]:
    accepted = [float(v) if v >= 0.0 else None for v in judged.accept_within_mm]
    return {
        "T_mm": judged.tolerance_mm,
        "U_over_T": judged.u_over_t.tolist(),
        "verdict": judged.verdict,
        "iso_14253_1": {
            "accept_within_mm": accepted,
            "reject_beyond_mm": judged.reject_beyond_mm.tolist(),
        },
    }
