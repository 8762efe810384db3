"""Whether a value is inside its tolerance, and whether it was measured well enough to say so."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from omm_core.errors import InputError

State = Literal["inside", "not proven", "outside"]
# U / T <= 20 % with T the full width (Berndt): U <= 0.4 of the half width.
LARGEST_SHARE = 0.4


@dataclass(frozen=True, kw_only=True)
class Decision:
    """A decision by ISO 14253-1, and whether it rests on a good enough measurement (Berndt).

    ``deviation`` and ``expanded_uncertainty`` in the unit of ``tolerance``, which is plus/minus.
    """

    deviation: float
    expanded_uncertainty: float
    tolerance: float
    state: State
    measured_well_enough: bool

    @property
    def advice(self) -> str:
        """Return what to do next, in words."""
        if self.state == "inside":
            return "good enough"
        if not self.measured_well_enough:
            return "measure better first"
        return "correct"


def decide(deviation: float, expanded_uncertainty: float, tolerance: float) -> Decision:
    """Decide: inside where ``|deviation| + U <= T``, outside where ``|deviation| - U > T``.

    Raises
    ------
    InputError
        Where tolerance or uncertainty is negative or not a number. A deviation that is not a
        number is not proven.
    """
    if not (tolerance > 0.0 and expanded_uncertainty >= 0.0):
        raise InputError(
            f"Expected a tolerance > 0 and U >= 0, got {tolerance} and {expanded_uncertainty}."
        )
    state: State = "not proven"
    if abs(deviation) + expanded_uncertainty <= tolerance:
        state = "inside"
    elif math.isfinite(deviation) and abs(deviation) - expanded_uncertainty > tolerance:
        state = "outside"
    return Decision(
        deviation=deviation,
        expanded_uncertainty=expanded_uncertainty,
        tolerance=tolerance,
        state=state,
        measured_well_enough=expanded_uncertainty <= LARGEST_SHARE * tolerance,
    )
