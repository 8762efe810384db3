"""What is known of a quantity: its spread, and how many degrees of freedom that spread has.

A distribution here has mean 0 and the standard uncertainty that the GUM gives it. Its Monte Carlo
samples follow JCGM 101:2008, 6.4: a normal spread with few degrees of freedom is Student's t
(6.4.9), a uniform one whose limits are not exactly known a curvilinear trapezoid (6.4.3). Both are
wider than the standard uncertainty says; that is what Monte Carlo is there to show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from omm_core.errors import InputError

Array = NDArray[np.float64]

# Half width over standard uncertainty (GUM 4.3.7, 4.3.9; JCGM 101 6.4.2 to 6.4.6).
_DIVISOR = {"uniform": math.sqrt(3.0), "triangular": math.sqrt(6.0), "arcsine": math.sqrt(2.0)}
_SAME = {"rectangular": "uniform", "u-shaped": "arcsine", "gaussian": "normal"}
KINDS = ("normal", *_DIVISOR)


def _kind(word: str) -> str:
    """Return a distribution's one name; capitals and the other names in use mean the same."""
    return _SAME.get(word.lower(), word.lower())


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """A distribution about zero.

    Attributes
    ----------
    kind : str
        normal, uniform, triangular or arcsine.
    standard_uncertainty : float
        In the unit of the quantity.
    degrees_of_freedom : float
        Infinite where the spread is exactly known.
    """

    kind: str
    standard_uncertainty: float
    degrees_of_freedom: float = math.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", _kind(self.kind))
        if self.kind not in KINDS:
            raise InputError(
                f"Expected one of the distributions {', '.join(KINDS)}, got {self.kind!r}."
            )
        if not (math.isfinite(self.standard_uncertainty) and self.standard_uncertainty >= 0.0):
            raise InputError(
                f"Expected a finite standard uncertainty >= 0, got {self.standard_uncertainty}."
            )
        if not self.degrees_of_freedom > 0.0:
            raise InputError(f"Expected degrees of freedom > 0, got {self.degrees_of_freedom}.")

    @classmethod
    def from_half_width(
        cls, kind: str, half_width: float, degrees_of_freedom: float = math.inf
    ) -> Distribution:
        """Return a bounded distribution from the half width of its interval.

        Raises
        ------
        InputError
            Where the kind has no limits (normal), or the half width is negative.
        """
        kind = _kind(kind)
        if kind not in _DIVISOR:
            raise InputError(
                f"Expected a distribution with limits ({', '.join(_DIVISOR)}) for a half width,"
                f" got {kind!r}: give standard_uncertainty, or half_width with coverage_factor."
            )
        return cls(
            kind=kind,
            standard_uncertainty=half_width / _DIVISOR[kind],
            degrees_of_freedom=degrees_of_freedom,
        )

    def from_normal(self, z: Array) -> Array:
        """Return samples from standard normal ones, by equal probability (so they may correlate).

        The samples are in units of the standard uncertainty.
        """
        if self.kind == "normal":
            if math.isinf(self.degrees_of_freedom):
                return z
            return np.asarray(stats.t.ppf(stats.norm.cdf(z), self.degrees_of_freedom))
        p = stats.norm.cdf(z)
        if self.kind == "uniform":
            return np.asarray((2.0 * p - 1.0) * _DIVISOR["uniform"])
        if self.kind == "arcsine":
            return np.asarray(np.sin(np.pi * (p - 0.5)) * _DIVISOR["arcsine"])
        side = 1.0 - np.sqrt(2.0 * np.minimum(p, 1.0 - p))
        return np.asarray(np.sign(p - 0.5) * side * _DIVISOR["triangular"])

    def sample(self, random: np.random.Generator, count: int) -> Array:
        """Return independent samples, (count,), in units of the standard uncertainty."""
        if self.kind == "normal":
            if math.isinf(self.degrees_of_freedom):
                return random.standard_normal(count)
            return random.standard_t(self.degrees_of_freedom, count)
        if self.kind == "arcsine":
            return np.sin(random.uniform(-np.pi / 2, np.pi / 2, count)) * _DIVISOR["arcsine"]
        if self.kind == "triangular":
            both = random.uniform(-0.5, 0.5, (2, count))
            return both.sum(axis=0) * _DIVISOR["triangular"]
        limit = np.ones(count)
        if math.isfinite(self.degrees_of_freedom):
            # GUM G.4.2: dof = 1/2 (Δu/u)^-2, and Δu/u is that of the half width.
            spread = 1.0 / math.sqrt(2.0 * self.degrees_of_freedom)
            limit = 1.0 + spread * random.uniform(-1.0, 1.0, count)
        return limit * random.uniform(-1.0, 1.0, count) * _DIVISOR["uniform"]
