"""Whether a measurement is good enough for a tolerance: Berndt's rule and ISO 14253-1.

``tolerance`` is a full width T everywhere here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from omm_core.errors import InputError

Array = NDArray[np.float64]

# The golden rule of metrology: U at most 20 % of T (Berndt, Hultsch, Weinhold 1968).
LARGEST_U_OVER_T = 0.2
# ISO 14253-1:2017, 4.4: conformity is proven where its probability is at least 95 %.
CONFORMITY_PROBABILITY = 0.95


@dataclass(frozen=True, kw_only=True, eq=False)
class Capability:
    """What U means for a tolerance of full width T; arrays of three, machine X Y Z.

    Attributes
    ----------
    tolerance_mm : float
    u_over_t : (3,) array
    capable : bool
        By Berndt's rule, on each axis.
    accept_within_mm : (3,) array
        ISO 14253-1: a deviation measured within ± this is proven to conform; negative where no
        measured value can prove it.
    reject_beyond_mm : (3,) array
        ISO 14253-1: beyond ± this it is proven not to conform.
    """

    tolerance_mm: float
    u_over_t: Array
    capable: bool
    accept_within_mm: Array
    reject_beyond_mm: Array

    @property
    def verdict(self) -> str:
        """Return ``capable`` or ``not capable``."""
        return "capable" if self.capable else "not capable"


def capability(expanded_mm: Array, standard_mm: Array, tolerance_mm: float) -> Capability:
    """Judge three expanded and standard uncertainties against a tolerance.

    Raises
    ------
    InputError
        Where the tolerance is no width.
    """
    if not tolerance_mm > 0.0:
        raise InputError(f"Expected a tolerance (full width) above 0 mm, got {tolerance_mm}.")
    ratio = np.asarray(expanded_mm, dtype=float) / tolerance_mm
    guards = np.array([guard_band(u, tolerance_mm) for u in np.atleast_1d(standard_mm)])
    outside = np.asarray(standard_mm) * stats.norm.ppf(CONFORMITY_PROBABILITY)
    return Capability(
        tolerance_mm=tolerance_mm,
        u_over_t=ratio,
        # 20 % is a rule of thumb: the last bit of a division must not decide.
        capable=bool(np.all(ratio <= LARGEST_U_OVER_T * (1 + 1e-12))),
        accept_within_mm=tolerance_mm / 2 - guards,
        reject_beyond_mm=tolerance_mm / 2 + outside,
    )


def conformity(deviation: float, standard_uncertainty: float, tolerance: float) -> float:
    """Return the probability that the true value is within ± T/2 (JCGM 106, 7.4; normal)."""
    if standard_uncertainty == 0.0:
        return float(abs(deviation) <= tolerance / 2)
    upper = stats.norm.cdf((tolerance / 2 - deviation) / standard_uncertainty)
    return float(upper - stats.norm.cdf((-tolerance / 2 - deviation) / standard_uncertainty))


def decide(deviation: float, standard_uncertainty: float, tolerance: float) -> str:
    """Return ``conforms`` or ``does not conform`` where that is proven, else ``not proven``.

    ISO 14253-1:2017: proven where its probability is at least 95 %.
    """
    probability = conformity(deviation, standard_uncertainty, tolerance)
    if probability >= CONFORMITY_PROBABILITY:
        return "conforms"
    return "does not conform" if probability <= 1.0 - CONFORMITY_PROBABILITY else "not proven"


def guard_band(standard_uncertainty: float, tolerance: float) -> float:
    """Return how far inside the limit a value must be to conform with 95 %; 1.65 u for a wide T.

    Larger than T/2 where not even the middle conforms with that probability.
    """
    if standard_uncertainty == 0.0:
        return 0.0
    half = tolerance / 2

    def missing(guard: float) -> float:
        found = conformity(half - guard, standard_uncertainty, tolerance)
        return found - CONFORMITY_PROBABILITY

    if missing(half) < 0.0:
        return float(half + standard_uncertainty)
    return float(optimize.brentq(missing, 0.0, half, xtol=1e-12 * max(half, 1.0)))
