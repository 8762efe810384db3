"""First order propagation (GUM 5) and Monte Carlo (JCGM 101) of one and the same model.

A model is a function of its inputs made of +, -, *, / and powers; GTC differentiates it, and numpy
arrays of samples go through it. Results agree in the sense of JCGM 101:2008, 8.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from omm_core.budget.distributions import Distribution
from omm_core.errors import InputError

Array = NDArray[np.float64]
Model = Callable[..., Any]
Correlation = Mapping[tuple[str, str], float]

# GUM: u(y) is told with two significant digits (JCGM 101, 7.9.2).
_DIGITS = 2


@dataclass(frozen=True, kw_only=True)
class Input:
    """One input quantity: its estimate and what is known of its spread."""

    name: str
    value: float
    distribution: Distribution


@dataclass(frozen=True, kw_only=True)
class FirstOrder:
    """What the GUM's law of propagation gives.

    Attributes
    ----------
    value, standard_uncertainty : float
    degrees_of_freedom : float
        Effective (Welch-Satterthwaite, GUM G.4).
    components : mapping
        |sensitivity| times standard uncertainty, by input.
    """

    value: float
    standard_uncertainty: float
    degrees_of_freedom: float
    components: Mapping[str, float]

    def coverage_factor(self, probability: float) -> float:
        """Return Student's factor for the effective degrees of freedom, not cut to a whole one."""
        return student_factor(probability, self.degrees_of_freedom)


@dataclass(frozen=True, kw_only=True)
class MonteCarlo:
    """What JCGM 101 gives: mean, standard uncertainty and the limits of a coverage interval."""

    value: float
    standard_uncertainty: float
    low: float
    high: float
    trials: int


def student_factor(probability: float, degrees_of_freedom: float) -> float:
    """Return the half width, in standard uncertainties, that holds a probability (GUM G.3)."""
    return float(student_factors(probability, np.array([degrees_of_freedom]))[0])


def student_factors(probability: float, degrees_of_freedom: Array) -> Array:
    """Return :func:`student_factor` of each, in the same shape; infinite ones are normal."""
    if not 0.0 < probability < 1.0:
        raise InputError(f"Expected a coverage probability between 0 and 1, got {probability}.")
    tail = 0.5 + probability / 2.0
    found = np.full(degrees_of_freedom.shape, float(stats.norm.ppf(tail)))
    finite = np.isfinite(degrees_of_freedom)
    found[finite] = stats.t.ppf(tail, degrees_of_freedom[finite])
    return found


def first_order(
    model: Model, inputs: Sequence[Input], correlation: Correlation | None = None
) -> FirstOrder:
    """Propagate by the GUM's law, differentiated by GTC.

    Raises
    ------
    InputError
        Where a correlation is beyond ±1 or names no input.
    """
    import GTC  # type: ignore[import-untyped]

    related = {name for pair in correlation or {} for name in pair}
    quantities = {}
    for one in inputs:
        spread = one.distribution
        # GTC takes correlated quantities only without degrees of freedom (GUM G.4.1 knows none).
        free = one.name not in related
        freedom = spread.degrees_of_freedom if free else math.inf
        quantities[one.name] = GTC.ureal(
            one.value, spread.standard_uncertainty, freedom, label=one.name, independent=free
        )
    for (first, second), r in (correlation or {}).items():
        if first not in quantities or second not in quantities or not -1.0 <= r <= 1.0:
            raise InputError(
                f"Expected a correlation from -1 to 1 between inputs, got {r} between {first} and"
                f" {second}."
            )
        GTC.set_correlation(r, quantities[first], quantities[second])
    result = model(*quantities.values())
    return FirstOrder(
        value=float(result.x),
        standard_uncertainty=float(result.u),
        degrees_of_freedom=float(result.df),
        components={n: abs(float(GTC.component(result, q))) for n, q in quantities.items()},
    )


def monte_carlo(
    model: Model,
    inputs: Sequence[Input],
    *,
    correlation: Correlation | None = None,
    probability: float = 0.95,
    trials: int = 1_000_000,
    shortest: bool = False,
    seed: int = 1,
) -> MonteCarlo:
    """Propagate distributions (JCGM 101, 7).

    Parameters
    ----------
    shortest : bool
        Return the shortest interval instead of the one with equal tails (5.3.4).
    """
    random = np.random.default_rng(seed)
    samples = draw([one.distribution for one in inputs],
                   correlation_matrix([one.name for one in inputs], correlation or {}),
                   random, trials)  # fmt: skip
    values = [
        one.value + one.distribution.standard_uncertainty * sample
        for one, sample in zip(inputs, samples)
    ]
    result = np.sort(np.broadcast_to(np.asarray(model(*values), dtype=float), (trials,)))
    low, high = _shortest(result, probability) if shortest else _equal_tails(result, probability)
    return MonteCarlo(
        value=float(result.mean()),
        standard_uncertainty=float(result.std(ddof=1)),
        low=low,
        high=high,
        trials=trials,
    )


def correlation_matrix(names: Sequence[str], correlation: Correlation) -> Array:
    """Return the correlations as a matrix in the order of the names.

    Raises
    ------
    InputError
        Where they contradict each other (no positive semidefinite matrix).
    """
    matrix = np.eye(len(names))
    for (first, second), r in correlation.items():
        i, j = names.index(first), names.index(second)
        matrix[i, j] = matrix[j, i] = r
    if len(names) and np.linalg.eigvalsh(matrix).min() < -1e-9:
        told = ", ".join(f"{a}–{b} {r:g}" for (a, b), r in correlation.items())
        raise InputError(f"Expected correlations that can be true together, got {told}.")
    return matrix


def draw(
    distributions: Sequence[Distribution],
    correlation: Array,
    random: np.random.Generator,
    count: int,
) -> Array:
    """Return samples in units of the standard uncertainties, (inputs, count).

    Correlated ones come from correlated normal samples, by equal probability, whose own correlation
    is such that the samples have the wanted one (:func:`normal_correlation`).
    """
    samples = np.empty((len(distributions), count))
    related = [i for i, row in enumerate(correlation) if np.count_nonzero(row) > 1]
    if related:
        wanted = correlation[np.ix_(related, related)].copy()
        for a, i in enumerate(related):
            for b, j in enumerate(related):
                if a != b:
                    wanted[a, b] = normal_correlation(
                        distributions[i].kind, distributions[j].kind, wanted[a, b]
                    )
        values, vectors = np.linalg.eigh(wanted)
        root = vectors * np.sqrt(np.clip(values, 0.0, None))
        normal = root @ random.standard_normal((len(related), count))
        for i, z in zip(related, normal):
            samples[i] = distributions[i].from_normal(z)
    for i, distribution in enumerate(distributions):
        if i not in related:
            samples[i] = distribution.sample(random, count)
    return samples


def normal_correlation(first: str, second: str, wanted: float) -> float:
    """Return the correlation of two normal quantities that makes two distributions' the wanted one.

    ``corr(f(z₁), g(z₂)) = Σ f_k g_k ρ^k`` with the coefficients of f and g in normalised Hermite
    polynomials (Mehler's formula); for two uniform ones ``ρ = 2 sin(π r / 6)``. A normal and a
    uniform quantity cannot correlate by more than √(3/π): beyond what can be, it is ±1.
    """
    if first == second == "normal" or wanted == 0.0:
        return wanted
    products = _hermite(first) * _hermite(second)

    def excess(rho: float) -> float:
        return float(np.polynomial.polynomial.polyval(rho, products)) - wanted

    if excess(1.0) <= 0.0 or excess(-1.0) >= 0.0:
        return math.copysign(1.0, wanted)
    return float(optimize.brentq(excess, -1.0, 1.0, xtol=1e-12))


@cache
def _hermite(kind: str) -> Array:
    """Return a distribution's coefficients in the normalised Hermite polynomials up to order 60."""
    z = np.linspace(-9.0, 9.0, 20_001)
    values = Distribution(kind=kind, standard_uncertainty=1.0).from_normal(z)
    weight = np.exp(-(z**2) / 2.0) / math.sqrt(2.0 * math.pi) * (z[1] - z[0])
    found, before, now = [0.0], np.zeros_like(z), np.ones_like(z)
    for k in range(60):
        # h_(k+1) = (z h_k - √k h_(k-1)) / √(k+1)
        before, now = now, (z * now - math.sqrt(k) * before) / math.sqrt(k + 1.0)
        found.append(float((weight * values * now).sum()))
    return np.array(found)


def tolerance_of(standard_uncertainty: float, digits: int = _DIGITS) -> float:
    """Return δ: half of the last digit of u, told with so many digits (JCGM 101, 7.9.2)."""
    if standard_uncertainty <= 0.0:
        return 0.0
    exponent = math.floor(math.log10(standard_uncertainty)) - (digits - 1)
    if round(standard_uncertainty / 10.0**exponent) >= 10**digits:
        exponent += 1
    return float(0.5 * 10.0**exponent)


def agree(first: FirstOrder, other: MonteCarlo, coverage_factor: float, digits: int = 2) -> bool:
    """Return whether the coverage intervals agree within δ at both ends (JCGM 101, 8.1)."""
    delta = tolerance_of(first.standard_uncertainty, digits)
    half = coverage_factor * first.standard_uncertainty
    off = max(abs(first.value - half - other.low), abs(first.value + half - other.high))
    return off <= delta


def _equal_tails(ordered: Array, probability: float) -> tuple[float, float]:
    low, high = np.quantile(ordered, [0.5 - probability / 2, 0.5 + probability / 2])
    return float(low), float(high)


def _shortest(ordered: Array, probability: float) -> tuple[float, float]:
    inside = round(probability * len(ordered))
    widths = ordered[inside:] - ordered[: len(ordered) - inside]
    start = int(np.argmin(widths))
    return float(ordered[start]), float(ordered[start + inside])
