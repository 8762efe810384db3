"""Analysis of variance: how much repeats scatter, and how much more clampings do.

One factor (clampings, each a group of repeats): value = mean + clamping + repeat, both random.
Three factors, crossed (AIAG MSA 4th edition, chapter III): value = part + appraiser + their
interaction + equipment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from omm_core.errors import InputError

Array = NDArray[np.float64]

# AIAG: an interaction that is not significant at this level is counted to the equipment.
POOLING_LEVEL = 0.25


@dataclass(frozen=True, kw_only=True)
class OneFactor:
    """Repeatability and reproducibility of one quantity; NaN where it cannot be known.

    Attributes
    ----------
    mean : float
        Of the groups' means.
    repeatability : float
        Standard deviation of repeats within a clamping (ISO 5725: s_r).
    between : float
        Standard deviation of the clampings' own part (s_L); 0 where the repeats explain it all.
    reproducibility : float
        √(repeatability² + between²): of one measurement after a new clamping (s_R).
    degrees_of_freedom : float
        Of the reproducibility, by Satterthwaite.
    p_value : float
        F test: how probable so much difference between clampings is if there is none.
    within_freedom, between_freedom : int
    """

    mean: float
    repeatability: float
    between: float
    reproducibility: float
    degrees_of_freedom: float
    p_value: float
    within_freedom: int
    between_freedom: int


def one_factor(groups: Sequence[ArrayLike]) -> OneFactor:
    """Analyse groups of repeats, which may differ in number (Searle's n_0).

    With one repeat each, only the reproducibility is known; with one group, only the repeatability.

    Raises
    ------
    InputError
        Where there are fewer than two values.
    """
    each = [np.asarray(group, dtype=float) for group in groups if np.size(group)]
    sizes = np.array([len(group) for group in each])
    count, total = len(each), int(sizes.sum())
    if total < 2:
        raise InputError(f"Expected at least 2 measurements, got {total}.")
    means = np.array([group.mean() for group in each])
    grand = float(np.sum(sizes * means) / total)
    inside, outside = total - count, count - 1
    within = sum(float(np.sum((group - mean) ** 2)) for group, mean in zip(each, means))
    ms_within = within / inside if inside else math.nan
    ms_between = float(np.sum(sizes * (means - grand) ** 2) / outside) if outside else math.nan
    repeatability = math.sqrt(ms_within) if inside else math.nan
    if not outside:
        between, reproducibility, freedom, p_value = math.nan, math.nan, math.nan, math.nan
    elif not inside:
        # One repeat each: what a clamping and what a repeat does cannot be told apart.
        between, p_value = math.nan, math.nan
        reproducibility, freedom = math.sqrt(ms_between), float(outside)
    else:
        each_size = (total - float(np.sum(sizes**2)) / total) / outside
        between = math.sqrt(max((ms_between - ms_within) / each_size, 0.0))
        reproducibility = math.hypot(repeatability, between)
        freedom = _satterthwaite(
            (ms_between / each_size, outside), ((1 - 1 / each_size) * ms_within, inside)
        )
        if between == 0.0:
            freedom = float(inside)
        p_value = float(stats.f.sf(ms_between / ms_within, outside, inside)) if within else 0.0
    return OneFactor(
        mean=float(means.mean()),
        repeatability=repeatability,
        between=between,
        reproducibility=reproducibility,
        degrees_of_freedom=freedom,
        p_value=p_value,
        within_freedom=inside,
        between_freedom=outside,
    )


def _satterthwaite(*parts: tuple[float, int]) -> float:
    needed = sum(value**2 / freedom for value, freedom in parts)
    return sum(value for value, _ in parts) ** 2 / needed if needed else float(parts[0][1])


@dataclass(frozen=True, kw_only=True)
class Crossed:
    """A gauge R&R study; the names are AIAG's. All but ``ndc`` are standard deviations.

    Attributes
    ----------
    ev, av, interaction, grr, pv, tv : float
        Equipment, appraiser, interaction, gauge, part, total variation.
    ndc : float
        Number of distinct categories, 1.41 PV/GRR.
    sums_of_squares : dict
        appraiser, part, interaction, equipment, total.
    pooled : bool
        Whether the interaction was counted to the equipment.
    """

    ev: float
    av: float
    interaction: float
    grr: float
    pv: float
    tv: float
    ndc: float
    sums_of_squares: dict[str, float]
    pooled: bool

    @property
    def percent_grr(self) -> float:
        """Return %GRR of the total variation."""
        return 100.0 * self.grr / self.tv


def crossed(values: ArrayLike, *, pooling_level: float = POOLING_LEVEL) -> Crossed:
    """Analyse a crossed study by ANOVA.

    Parameters
    ----------
    values : (appraisers, trials, parts) array

    Raises
    ------
    InputError
        Where there are not at least two of each.
    """
    x = np.asarray(values, dtype=float)
    if x.ndim != 3 or min(x.shape) < 2 or not np.isfinite(x).all():
        raise InputError(
            "Expected finite values of at least 2 appraisers, 2 trials and 2 parts, got the shape"
            f" {x.shape}."
        )
    a, n, p = x.shape
    grand = x.mean()
    of_a, of_p, of_ap = x.mean(axis=(1, 2)), x.mean(axis=(0, 1)), x.mean(axis=1)
    squares = {
        "appraiser": float(n * p * np.sum((of_a - grand) ** 2)),
        "part": float(n * a * np.sum((of_p - grand) ** 2)),
        "interaction": float(n * np.sum((of_ap - of_a[:, None] - of_p[None] + grand) ** 2)),
        "equipment": float(np.sum((x - of_ap[:, None]) ** 2)),
        "total": float(np.sum((x - grand) ** 2)),
    }
    free_i, free_e = (a - 1) * (p - 1), a * p * (n - 1)
    ms_e, ms_i = squares["equipment"] / free_e, squares["interaction"] / free_i
    pooled = ms_e > 0.0 and float(stats.f.sf(ms_i / ms_e, free_i, free_e)) > pooling_level
    if pooled:
        ms_e = (squares["equipment"] + squares["interaction"]) / (free_e + free_i)
        ms_i = ms_e
    ev2, int2 = ms_e, max((ms_i - ms_e) / n, 0.0)
    av2 = max((squares["appraiser"] / (a - 1) - ms_i) / (n * p), 0.0)
    pv2 = max((squares["part"] / (p - 1) - ms_i) / (n * a), 0.0)
    return _study(ev2, av2, int2, pv2, squares, pooled)


def average_and_range(values: ArrayLike) -> Crossed:
    """Analyse a crossed study, (appraisers, trials, parts), by averages and ranges (X̄–R).

    The factors are 1/d2* (Duncan; AIAG's K1 to K3). There is no interaction in it.
    """
    x = np.asarray(values, dtype=float)
    if x.ndim != 3 or min(x.shape) < 2:
        raise InputError(f"Expected at least 2 of each, got the shape {x.shape}.")
    a, n, p = x.shape
    ev = float(np.ptp(x, axis=1).mean()) / d2_star(n, a * p)
    between = float(np.ptp(x.mean(axis=(1, 2)))) / d2_star(a, 1)
    av2 = max(between**2 - ev**2 / (n * p), 0.0)
    pv = float(np.ptp(x.mean(axis=(0, 1)))) / d2_star(p, 1)
    return _study(ev**2, av2, 0.0, pv**2, {}, True)


def d2_star(size: int, ranges: int) -> float:
    """Return d2*: mean range of normal samples of a size, corrected for how few there are.

    d2*² = d2² + Var(range)/ranges (Duncan 1955), from the range's exact moments.
    """
    mean, variance = _range_moments(size)
    return math.sqrt(mean**2 + variance / ranges) if ranges < 16 else mean


def _range_moments(size: int) -> tuple[float, float]:
    """Return mean and variance of the range of ``size`` standard normal values."""
    step = 0.01
    x = np.arange(-8.0, 8.0 + step / 2, step)
    cdf = stats.norm.cdf(x)
    mean = float(np.sum(1 - cdf**size - (1 - cdf) ** size) * step)
    # E[R²] = 2 ∫∫_{x<y} (1 − F(y)^n − (1 − F(x))^n + (F(y) − F(x))^n) dx dy
    low, high = cdf[:, None], cdf[None]
    inner = 1 - high**size - (1 - low) ** size + np.clip(high - low, 0, None) ** size
    second = 2.0 * float(np.sum(np.triu(inner, 1)) + np.trace(inner) / 2) * step**2
    return mean, second - mean**2


def _study(
    ev2: float, av2: float, int2: float, pv2: float, squares: dict[str, float], pooled: bool
) -> Crossed:
    grr, pv = math.sqrt(ev2 + av2 + int2), math.sqrt(pv2)
    return Crossed(
        ev=math.sqrt(ev2),
        av=math.sqrt(av2),
        interaction=math.sqrt(int2),
        grr=grr,
        pv=pv,
        tv=math.hypot(grr, pv),
        ndc=1.41 * pv / grr if grr else math.inf,
        sums_of_squares=squares,
        pooled=pooled,
    )
