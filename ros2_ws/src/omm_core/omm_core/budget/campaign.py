"""A campaign: one part measured in k clampings, n times each, and what that says of the gauge."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.anova import OneFactor, one_factor
from omm_core.budget.campaign_file import THETA
from omm_core.budget.gauge import (
    Drift,
    GaugeCapability,
    Prediction,
    against_prediction,
    drift,
    gauge_capability,
)
from omm_core.budget.sources import pose_jacobian
from omm_core.budget.stray_runs import stray_runs
from omm_core.errors import InputError

Array = NDArray[np.float64]

_ANGLES = [0, 1, 2, 6]


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredRun:
    """One measurement of a campaign, solved.

    Attributes
    ----------
    theta : (7,) array
        Rad and mm, 7D.
    covariance : (7, 7) array
    theta_6d : (7,) array or None
        Solved with γ_s taken as 0, as in the paper's table 2.
    truth : (7,) array or None
        In simulation.
    """

    clamping: int
    repeat: int
    theta: Array
    covariance: Array
    theta_6d: Array | None = None
    truth: Array | None = None
    name: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class QuantityStudy:
    """What a campaign says of one quantity, in its own unit (rad or mm).

    Attributes
    ----------
    study : OneFactor
    sigma : float
        Standard deviation of what was measured, over all runs (the paper's tables: twice that).
    predicted : float
        Root mean square of the standard deviations that the runs predicted.
    sigma_6d : float
        Standard deviation over all runs, solved with γ_s = 0; NaN where not solved so.
    between, within : Drift
        From clamping to clamping, and from repeat to repeat.
    capability : GaugeCapability or None
        Where a tolerance is given.
    """

    name: str
    study: OneFactor
    sigma: float
    predicted: float
    sigma_6d: float
    between: Drift
    within: Drift
    capability: GaugeCapability | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Campaign:
    """A campaign evaluated; ``prediction`` is None where nothing can be compared."""

    measured: tuple[MeasuredRun, ...]
    clampings: int
    repeats: tuple[int, ...]
    quantities: tuple[QuantityStudy, ...]
    prediction: Prediction | None
    findings: tuple[str, ...]

    def quantity(self, name: str) -> QuantityStudy:
        """Return the study of one of θ."""
        return next(one for one in self.quantities if one.name == name)


def groups_of(measured: Sequence[MeasuredRun], values: Array) -> list[Array]:
    """Return values (N,) by clamping, both in order."""
    order = sorted(range(len(measured)), key=lambda i: (measured[i].clamping, measured[i].repeat))
    found: dict[int, list[float]] = {}
    for i in order:
        found.setdefault(measured[i].clamping, []).append(float(values[i]))
    return [np.array(group) for group in found.values()]


def evaluate_campaign(
    measured: Sequence[MeasuredRun],
    *,
    tolerances: Mapping[str, float] | None = None,
    reference: Mapping[str, float] | None = None,
) -> Campaign:
    """Evaluate a campaign.

    γ_s differs from clamping to clamping by nature: of it, the repeatability alone speaks of the
    measurement, unless the truth is known.

    Raises
    ------
    InputError
        Where there are fewer than two measurements.
    """
    ordered = sorted(measured, key=lambda m: (m.clamping, m.repeat))
    if len(ordered) < 2:
        raise InputError(f"Expected at least 2 measurements in a campaign, got {len(ordered)}.")
    values, known = _values(ordered)
    quantities = tuple(
        _quantity(ordered, values, known, index, tolerances or {}, reference or {})
        for index in range(len(THETA))
    )
    groups = groups_of(ordered, values[:, 0])
    findings = [
        f"{one.name} drifts by {change.per_step:.3g} from {step} to the next (p ="
        f" {change.p_value:.2g})"
        for one in quantities
        for change, step in ((one.between, "clamping"), (one.within, "repeat"))
        # Fourteen tests are made: each at a fourteenth of 1 %.
        if change.p_value < 0.01 / 14 and (known or one.name != "gamma_s_rad")
    ]
    return Campaign(
        measured=tuple(ordered),
        clampings=len(groups),
        repeats=tuple(len(group) for group in groups),
        quantities=quantities,
        prediction=_prediction(ordered, values, known),
        findings=(*findings, *_strays(ordered, values)),
    )


def _strays(measured: Sequence[MeasuredRun], values: Array) -> list[str]:
    """Name each run that strays from its clamping, with the quantity that strays farthest."""
    farthest: dict[int, tuple[float, str]] = {}
    for run, quantity, t in stray_runs([m.clamping for m in measured], values[:, :6]):
        farthest[run] = max(farthest.get(run, (0.0, "")), (t, THETA[quantity]))
    return [
        f"{measured[run].name or 'a run'} (clamping {measured[run].clamping}, repeat"
        f" {measured[run].repeat}) strays: its {name} lies {min(t, 999.0):.0f} times the others' σ"
        " from the others of its clamping; see why, it is counted"
        for run, (t, name) in farthest.items()
    ]


def mean_theta(measured: Sequence[MeasuredRun]) -> Array:
    """Return the mean θ (7,) of all measurements."""
    return np.asarray(_unwrapped([m.theta for m in measured]).mean(axis=0))


def point_studies(measured: Sequence[MeasuredRun], xyz_mm: Array) -> list[list[OneFactor]]:
    """Return the analysis of points' machine coordinates: for each point (P, 3) its three axes."""
    values, _ = _values(measured)
    jacobian = pose_jacobian(mean_theta(measured).tolist(), xyz_mm)
    # Deviations are small: the coordinates are linear in them.
    off = np.einsum("pai,ki->kpa", jacobian, values[:, :6] - values[:, :6].mean(axis=0))
    return [
        [one_factor(groups_of(measured, off[:, p, axis])) for axis in range(3)]
        for p in range(len(xyz_mm))
    ]


def _values(measured: Sequence[MeasuredRun]) -> tuple[Array, bool]:
    """Return θ (N, 7), as errors where the truth of all is known."""
    theta = _unwrapped([m.theta for m in measured])
    truths = [m.truth for m in measured if m.truth is not None]
    if len(truths) < len(measured):
        return theta, False
    errors = theta - np.array(truths)
    turns = np.round(errors[:, _ANGLES] / (2 * np.pi))
    errors[:, _ANGLES] -= 2 * np.pi * turns
    return errors, True


def _unwrapped(thetas: Sequence[Array]) -> Array:
    """Return θ (N, 7) with angles that do not jump by 2π: runs are close to each other."""
    theta = np.array(thetas, dtype=float)
    theta[:, _ANGLES] -= 2 * np.pi * np.round((theta[:, _ANGLES] - theta[0, _ANGLES]) / (2 * np.pi))
    return theta


def _quantity(
    measured: Sequence[MeasuredRun],
    values: Array,
    known: bool,
    index: int,
    tolerances: Mapping[str, float],
    reference: Mapping[str, float],
) -> QuantityStudy:
    name = THETA[index]
    groups = groups_of(measured, values[:, index])
    study = one_factor(groups)
    between, within = drift(groups)
    bias = study.mean if known else study.mean - reference.get(name, math.nan)
    sixes = [m.theta_6d for m in measured if m.theta_6d is not None]
    capability = None
    if name in tolerances:
        capability = gauge_capability(study, tolerances[name], bias)
    return QuantityStudy(
        name=name,
        study=study,
        sigma=_sigma([m.theta for m in measured], index),
        predicted=float(np.sqrt(np.mean([m.covariance[index, index] for m in measured]))),
        sigma_6d=_sigma(sixes, index),
        between=between,
        within=within,
        capability=capability,
    )


def _sigma(thetas: Sequence[Array], index: int) -> float:
    if len(thetas) < 2:
        return math.nan
    return float(np.std(_unwrapped(thetas)[:, index], ddof=1))


def _prediction(measured: Sequence[MeasuredRun], values: Array, known: bool) -> Prediction | None:
    """Compare with the predicted covariances; γ_s is left out where it truly differs."""
    size = 7 if known else 6
    covariances = np.array([m.covariance[:size, :size] for m in measured])
    if not np.all(np.einsum("kii->ki", covariances) > 0.0):
        return None
    truth = np.zeros(size) if known else None
    return against_prediction(values[:, :size], covariances, truth)
