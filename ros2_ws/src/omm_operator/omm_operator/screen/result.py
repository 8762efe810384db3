"""The result as it is read: mm/m and mm, each value with U, and its tolerance decided."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from omm_core.alignment.tolerance import Decision, decide
from omm_core.files.part import Part
from omm_core.session.quantities import THETA
from omm_operator.screen.facts import EstimateFact


@dataclass(frozen=True, kw_only=True)
class Row:
    """One quantity, in rad or mm; ``decision`` is None where the part states no tolerance."""

    key: str
    value: float
    expanded_uncertainty: float
    nominal: float | None
    decision: Decision | None

    def to_json_dict(self) -> dict[str, Any]:
        """Return what a page shows: in ``unit``, null where there is no number."""
        quantity = next(q for q in THETA if q.key == self.key)
        scale, decision = quantity.scale, self.decision
        return {
            "key": self.key,
            "symbol": quantity.symbol,
            "unit": quantity.unit,
            "value": number(self.value * scale),
            "U": number(self.expanded_uncertainty * scale),
            "nominal": number(self.nominal * scale) if self.nominal is not None else None,
            "deviation": number(decision.deviation * scale) if decision else None,
            "tolerance": number(decision.tolerance * scale) if decision else None,
            "state": decision.state if decision else None,
            "well": decision.measured_well_enough if decision else None,
        }


def rows(estimate: EstimateFact, part: Part | None) -> tuple[Row, ...]:
    """Return the seven quantities in the order of θ."""
    wanted = nominal_theta(part)
    tolerances = {} if part is None else part.tolerances
    found = []
    for k, quantity in enumerate(THETA):
        value, uncertainty = float(estimate.theta[k]), float(estimate.expanded_uncertainty[k])
        nominal = wanted[k] if k < len(wanted) else None
        tolerance, decision = tolerances.get(quantity.key), None
        if nominal is not None and tolerance is not None and math.isfinite(uncertainty):
            deviation = deviation_of(k, value, nominal)
            decision = decide(deviation, uncertainty, tolerance)
        found.append(
            Row(
                key=quantity.key,
                value=value,
                expanded_uncertainty=uncertainty,
                nominal=nominal,
                decision=decision,
            )
        )
    return tuple(found)


def nominal_theta(part: Part | None) -> tuple[float | None, ...]:
    """Return the wanted α, β, γ, x, y, z; None where anywhere will do."""
    if part is None or part.nominal is None:
        return (None,) * 6
    return (*part.nominal.euler_xyz_rad, *part.nominal.translation_mm)


def deviation_of(k: int, value: float, nominal: float) -> float:
    """Return value minus nominal; of an angle, the turn by less than 180°."""
    difference = value - nominal
    return math.remainder(difference, 2.0 * math.pi) if k < 3 else difference


def advice(found: Sequence[Row]) -> str:
    """Return what to do next: ``none`` where nothing is toleranced, else the worst case's word.

    One value that is not inside needs a correction; but where one of those was not measured well
    enough, that comes first.
    """
    decisions = [row.decision for row in found if row.decision is not None]
    if not decisions:
        return "none"
    if all(decision.state == "inside" for decision in decisions):
        return "good"
    open_ones = [decision for decision in decisions if decision.state != "inside"]
    return "correct" if all(d.measured_well_enough for d in open_ones) else "measure"


def number(value: float) -> float | None:
    """Return a number that JSON has, else None."""
    return float(value) if np.isfinite(value) else None
