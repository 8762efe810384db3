"""From observations to a solution that can be believed, or to words for why there is none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Part
from omm_core.imaging.calibration import CameraCalibration
from omm_core.part_pose.adjustment import Adjustment, adjust, moved, predictions
from omm_core.part_pose.blunders import BlunderSearch, search_blunders
from omm_core.part_pose.fit import as_likely
from omm_core.part_pose.machine_noise import MachineNoise, summarise
from omm_core.part_pose.machine_words import better_than_declared, disagreement, remarks
from omm_core.part_pose.naming import MIRRORED, all_wrong, cannot_tell
from omm_core.part_pose.observability import not_determined
from omm_core.part_pose.observation import Observation, SolveOptions
from omm_core.part_pose.posterior import NO_POSE, PoseStatement, Posterior
from omm_core.part_pose.problem import Problem, build_problem
from omm_core.part_pose.solution import Solution
from omm_core.part_pose.statistics import analyse_posterior, chi2_limit
from omm_core.words import Words, keyed

Array = NDArray[np.float64]

_MIRRORED_PX = 2.0  # residuals below which mirrored images fit
_ENOUGH_TO_JUDGE = 3  # degrees of freedom from which residuals tell more than that all is wrong
_ENOUGH = 200  # centres; evenly spread ones are taken where there are more
_DOUBTED = 0.001  # error probability of the test of a declared machine


def solve(
    observations: Sequence[Observation],
    part: Part,
    calibration: CameraCalibration,
    options: SolveOptions | None = None,
    *,
    run_ns: Iterable[int] = (),
) -> Solution:
    """Solve the 7D (or 6D) problem from nothing.

    Parameters
    ----------
    observations : sequence of Observation
        In any order; the result does not depend on it.
    part, calibration
        What is known.
    options : SolveOptions
        How to solve.
    run_ns : iterable of int
        Stamps of all images of the run, by which words count them; default: of the observations.

    Raises
    ------
    InputError
        Where an observation is malformed, or of a target that the part does not have.
    """
    options = options or SolveOptions()
    problem = build_problem(observations, part, calibration, options.circle_centre, run_ns=run_ns)
    many = _more_than_needed(problem)
    few = problem.without(many) if many.any() else problem
    found = search_blunders(few, options)
    found = _refuse_contradiction(few, found, options)
    found = _judge_determined(found, options)
    return _solution(problem, _of_all(found, many) if many.any() else found, options)


def _more_than_needed(problem: Problem) -> NDArray[np.bool_]:
    """Return which centres are left out because there are so many, (N,).

    Every machine of the grid costs the cube of their number, and the stops' noise is averaged out
    long before: of each target so many stay, evenly spread over its images.
    """
    many = np.zeros(len(problem), dtype=bool)
    if len(problem) <= _ENOUGH:
        return many
    seen, counts = np.unique(problem.target_of, return_counts=True)
    most = _share_out(counts, _ENOUGH)
    for target, count in zip(seen, counts):
        index = np.flatnonzero(problem.target_of == target)
        kept = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))
        many[np.delete(index, kept)] = True
    return many


def _share_out(counts: NDArray[np.int64], enough: int) -> int:
    """Return how many of each may stay so that all together are about enough."""
    most = 1
    while np.minimum(counts, most + 1).sum() <= enough:
        most += 1
    return most


def _of_all(found: BlunderSearch, many: NDArray[np.bool_]) -> BlunderSearch:
    """Return what was found with some of the centres as said of all, (N,)."""
    place = np.flatnonzero(~many)
    dropped = many.copy()
    dropped[place] = found.dropped
    enough = keyed(
        "said.not_needed",
        "not needed: {n} centres are used, evenly spread over the images of each target",
        n=len(place),
    )
    reasons = {int(i): enough for i in np.flatnonzero(many)}
    reasons |= {int(place[index]): words for index, words in found.reasons.items()}
    return replace(found, dropped=dropped, reasons=reasons)


def _refuse_contradiction(
    problem: Problem, found: BlunderSearch, options: SolveOptions
) -> BlunderSearch:
    """Refuse residuals that no machine explains; smaller ones are noise, and the noise is told."""
    propagation = found.fit.propagation
    if not found.contradictory or propagation is None or not options.find_errors:
        return found
    rms_px = _rms(propagation.raw_residuals_px)
    worst_mm = options.worst_machine_mm
    if found.fit.degrees_of_freedom < _ENOUGH_TO_JUDGE:
        words = cannot_tell(rms_px, worst_mm)
    elif _fits_mirrored(problem, options, rms_px):
        words = MIRRORED
    else:
        words = all_wrong(problem, rms_px, worst_mm)
    return replace(found, fit=replace(found.fit, missing=(*found.fit.missing, words)))


def _fits_mirrored(problem: Problem, options: SolveOptions, rms_px: float) -> bool:
    mirrored = problem.measured.copy()
    mirrored[:, 0] = problem.calibration.width_px - 1 - mirrored[:, 0]
    other = replace(problem, measured=mirrored)
    minima = adjust(other, options)
    if not minima:
        return False
    residuals = predictions(other, minima[0])[0] - mirrored
    return _rms(residuals) < min(_MIRRORED_PX, rms_px / 10)


def _judge_determined(found: BlunderSearch, options: SolveOptions) -> BlunderSearch:
    """Name what is not determined, given the noise."""
    fit, estimated = found.fit, found.posterior
    if fit.missing or estimated is None or fit.best is None:
        return found
    covariance = estimated.local_covariance(own=True)
    missing, poor = not_determined(fit.problem, fit.best, covariance, options)
    cost, freedom = fit.minima[0].cost, fit.degrees_of_freedom
    scale = max(1.0, cost / freedom) if freedom > 0 else 1.0
    missing += as_likely(fit.minima, fit.best, scale)
    return replace(found, fit=replace(fit, missing=tuple(missing), poor=tuple(poor)))


def _solution(problem: Problem, found: BlunderSearch, options: SolveOptions) -> Solution:
    fit, estimated = found.fit, found.posterior
    determined = fit.determined and estimated is not None
    own = absolute = NO_POSE
    noise: MachineNoise | None = None
    shares: dict[str, Array] = {}
    factor, findings = 1.0, found.findings
    told: tuple[Words, ...] = ()
    shown = fit.best
    if determined and estimated is not None:
        factor, wrong, doubts = _factor(estimated, options)
        findings = (*findings, *wrong)
        own = _enlarged(estimated.statement(own=True), factor)
        absolute = _enlarged(estimated.statement(own=False), factor)
        shown = moved(estimated.model.adjustment, estimated.local_mean(own=False))
        shares = estimated.shares()
        noise = summarise(estimated.grid, estimated.weight)
        told = (*remarks(problem, noise, shares, options.unknowns), *doubts)
    residuals = np.full((len(problem), 2), np.nan)
    if shown is not None:
        residuals = predictions(problem, shown)[0] - problem.measured
    return Solution(
        model=options.model,
        determined=determined,
        converged=determined and _converged(fit.best),
        iterations=fit.best.iterations if fit.best is not None else 0,
        own=own,
        absolute=absolute,
        geometry_declared=options.geometry_sigma_mm is not None,
        machine=noise,
        covariance_factor=factor,
        shares=shares,
        rms_px=_rms(residuals[~found.dropped]),
        observations=problem.observations,
        used=~found.dropped if determined else np.zeros(len(problem), dtype=bool),
        reasons=tuple(found.reasons.get(index) for index in range(len(problem))),
        residuals_px=residuals,
        statistics=None if estimated is None else analyse_posterior(estimated, options),
        missing=fit.missing,
        poor=fit.poor,
        findings=findings,
        remarks=told,
    )


def _converged(best: Adjustment | None) -> bool:
    return best is not None and best.converged


def _factor(
    estimated: Posterior, options: SolveOptions
) -> tuple[float, tuple[Words, ...], tuple[Words, ...]]:
    """Return what a declared machine's covariance must be multiplied with, findings, remarks."""
    declared = (options.stop_sigma_mm, options.geometry_sigma_mm)
    m = estimated.model.redundancy
    if all(sigma is None for sigma in declared) or m < 1:
        return 1.0, (), ()
    cost = float(estimated.weight @ estimated.fit)
    if cost > chi2_limit(m, _DOUBTED):
        return cost / m, (disagreement(float(np.sqrt(cost / m))),), ()
    if cost < chi2_limit(m, 1.0 - _DOUBTED):
        return 1.0, (), (better_than_declared(float(np.sqrt(m / cost))),)
    return 1.0, (), ()


def _enlarged(statement: PoseStatement, factor: float) -> PoseStatement:
    return PoseStatement(
        theta=statement.theta,
        covariance=statement.covariance * factor,
        expanded_uncertainty=statement.expanded_uncertainty * np.sqrt(factor),
    )


def _rms(residuals_px: Array) -> float:
    """Return sqrt(mean(dcol² + drow²) / 2): per coordinate, NaN where there is none."""
    return float(np.sqrt(np.mean(residuals_px**2))) if residuals_px.size else float("nan")
