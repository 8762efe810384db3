"""Gauge capability as VDA 5 and MSA name it, drift, and whether a predicted covariance is true."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from omm_core.budget.anova import OneFactor
from omm_core.errors import InputError

Array = NDArray[np.float64]

# Type 1 study: the gauge may use this part of T, and 6 standard deviations are looked at.
PART_OF_TOLERANCE = 0.2
ENOUGH_CG = 1.33
# VDA 5: capability ratios of a measuring process, 2 U / T.
LARGEST_Q_MP = 0.30
SIGNIFICANCE = 0.01


@dataclass(frozen=True, kw_only=True)
class GaugeCapability:
    """What a gauge does of a tolerance of full width T.

    Attributes
    ----------
    cg, cgk : float
        Type 1: 0.2 T / 6 s and (0.1 T − |bias|) / 3 s; Cgk is NaN without a reference value.
    grr : float
        6 s of repeats and clampings over T (%GRR of the tolerance, AIAG).
    q_mp : float
        VDA 5: 2 U / T with U = 2 √(u_EVO² + u_AV² + u_BI²).
    """

    tolerance: float
    cg: float
    cgk: float
    grr: float
    q_mp: float

    @property
    def verdict(self) -> str:
        """Return ``capable`` where Cg and Cgk (where known) reach 1.33 and Q_MP is at most 30 %."""
        good = self.cg >= ENOUGH_CG and not self.cgk < ENOUGH_CG and self.q_mp <= LARGEST_Q_MP
        return "capable" if good else "not capable"


def type_1(
    standard_deviation: float,
    tolerance: float,
    bias: float = math.nan,
    *,
    part: float = PART_OF_TOLERANCE,
) -> tuple[float, float]:
    """Return Cg and Cgk (NaN without a bias).

    ``part`` is how much of T the gauge may use. No spread at all makes them infinite.

    Raises
    ------
    InputError
        Where tolerance or standard deviation is negative or not a number.
    """
    if not (tolerance > 0.0 and standard_deviation >= 0.0 and part > 0.0):
        raise InputError(
            f"Expected T > 0 and s >= 0, got T = {tolerance} and s = {standard_deviation}."
        )
    left = part / 2 * tolerance - abs(bias)
    if standard_deviation == 0.0:
        return math.inf, math.nan if math.isnan(bias) else math.copysign(math.inf, left)
    return part * tolerance / (6 * standard_deviation), left / (3 * standard_deviation)


def gauge_capability(study: OneFactor, tolerance: float, bias: float = math.nan) -> GaugeCapability:
    """Judge what a campaign found; s is that of one measurement after a new clamping.

    Where there was one clamping only, s is that of the repeats.
    """
    s = study.reproducibility
    s = study.repeatability if math.isnan(s) else s
    cg, cgk = type_1(s, tolerance, bias)
    # VDA 5: the bias, of which only |Bi| is known, is uniform: u_BI = |Bi| / √3.
    u_bias = 0.0 if math.isnan(bias) else abs(bias) / math.sqrt(3.0)
    return GaugeCapability(
        tolerance=tolerance,
        cg=cg,
        cgk=cgk,
        grr=6.0 * s / tolerance,
        q_mp=4.0 * math.hypot(s, u_bias) / tolerance,
    )


@dataclass(frozen=True, kw_only=True)
class Drift:
    """A straight line through values in the order in which they were taken.

    Attributes
    ----------
    per_step : float
        From one clamping (or one repeat) to the next.
    p_value : float
        How probable so steep a line is if nothing drifts; NaN below three steps.
    """

    per_step: float
    p_value: float

    @property
    def significant(self) -> bool:
        """Whether it is there at 1 %."""
        return self.p_value < SIGNIFICANCE


def drift(groups: Sequence[ArrayLike]) -> tuple[Drift, Drift]:
    """Return the drift from clamping to clamping, and from repeat to repeat within one.

    The first is tested on the clampings' means: repeats of one clamping are not independent of each
    other where clampings differ. The second takes each clamping's mean out.
    """
    each = [np.asarray(group, dtype=float) for group in groups if np.size(group)]
    means = np.array([group.mean() for group in each])
    between = _line(np.arange(len(means), dtype=float), means, 2)
    steps = [np.arange(len(group)) - (len(group) - 1) / 2 for group in each]
    values = np.concatenate([group - group.mean() for group in each])
    return between, _line(np.concatenate(steps), values, 1 + len(each))


def _line(steps: Array, values: Array, fitted: int) -> Drift:
    """Fit; ``fitted`` is how many numbers are taken out (means, slope)."""
    freedom = len(values) - fitted
    x = steps - steps.mean()
    square = float(x @ x)
    if freedom < 1 or square == 0.0:
        return Drift(per_step=math.nan, p_value=math.nan)
    slope = float(x @ values) / square
    left = values - values.mean() - slope * x
    sigma = math.sqrt(float(left @ left) / freedom / square)
    if sigma == 0.0:
        return Drift(per_step=slope, p_value=0.0 if slope else 1.0)
    return Drift(per_step=slope, p_value=float(2.0 * stats.t.sf(abs(slope) / sigma, freedom)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """Whether what was seen is what the covariances of the single runs predict.

    Attributes
    ----------
    statistic, degrees_of_freedom, p_value : float
        Scatter: Σ of squared deviations from the campaign's own mean, normalised by the predicted
        covariances; χ² where all errors are anew in each run. What all runs share (calibration,
        targets, geometry) does not scatter: a prediction can be found too small, never too large.
    ratio : (n,) array
        Standard deviation seen over predicted, by quantity.
    bias, bias_p_value : float
        Where the truth is known: the mean error squared, normalised by one run's covariance, as if
        all runs shared all errors; and how probable so much or more is (χ² with n). NaN otherwise.
    squared_error : float
        Mean normalised squared error from the truth: n where the prediction is true and the
        campaign long; NaN where the truth is not known.
    """

    statistic: float
    degrees_of_freedom: int
    p_value: float
    ratio: Array
    bias: float = math.nan
    bias_p_value: float = math.nan
    squared_error: float = math.nan

    @property
    def against_truth(self) -> bool:
        """Whether the truth was known."""
        return not math.isnan(self.bias)

    @property
    def believed(self) -> bool:
        """Whether there is neither more scatter nor more mean error than predicted, at 1 %."""
        return self.p_value >= SIGNIFICANCE and not self.bias_p_value < SIGNIFICANCE


def against_prediction(values: Array, covariances: Array, truth: Array | None = None) -> Prediction:
    """Compare values (N, n) with their predicted covariances (N, n, n).

    Parameters
    ----------
    truth : (n,) array, optional

    Raises
    ------
    InputError
        Where there is nothing to compare.
    """
    values = np.asarray(values, dtype=float)
    count, size = values.shape
    if count < 2:
        raise InputError(f"Expected at least 2 runs to compare with their prediction, got {count}.")
    # Scaled, since rad and mm differ by orders of magnitude.
    sigma = np.sqrt(np.einsum("kii->ki", covariances).mean(axis=0))
    inverse: Array = np.asarray(np.linalg.inv(covariances / np.outer(sigma, sigma)), dtype=float)
    total = inverse.sum(axis=0)
    mean = np.linalg.solve(total, np.einsum("kij,kj->i", inverse, values / sigma))
    off = values / sigma - mean
    statistic = _normalised(off, inverse)
    freedom = (count - 1) * size
    bias, bias_p_value, squared = math.nan, math.nan, math.nan
    if truth is not None:
        error = mean - truth / sigma
        bias = float(error @ (total / count) @ error)
        bias_p_value = float(stats.chi2.sf(bias, size))
        squared = _normalised((values - truth) / sigma, inverse) / count
    return Prediction(
        statistic=statistic,
        degrees_of_freedom=freedom,
        p_value=float(stats.chi2.sf(statistic, freedom)),
        ratio=np.sqrt(np.sum(off**2, axis=0) / (count - 1)),
        bias=bias,
        bias_p_value=bias_p_value,
        squared_error=squared,
    )


def _normalised(off: Array, inverse: Array) -> float:
    return float(np.einsum("ki,kij,kj->", off, inverse, off))
