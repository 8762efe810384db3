"""Search for wrong observations where the machine's noise is not known: Bayes factors.

That a target was displaced, or that all of an image is off, is a hypothesis that adds noise to
some rows: N(0, (1 mm)²) for each axis of the target, N(0, (20 px)²) for each coordinate of the
image. How much more likely the data are with it than without, over all machines that there may be,
is its Bayes factor B. With ln B > 1 something is wrong, and the largest B says what; what comes
within a factor of 20 of it cannot be told from it, and both are named. What is wrong is left out,
everything solved again, and the rest searched again.

Errors so large that no machine's noise comes near, and that may have led the fit astray, are found
before by leaving out and solving from nothing (snooping.py), with the noise of the worst machine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.fit import PoseFit, fit
from omm_core.part_pose.grid_kernels import NoiseBlocks, bayes_factors
from omm_core.part_pose.machine_noise import NoiseGrid, both_grids, geometry_lengths
from omm_core.part_pose.naming import (
    cannot_leave_out,
    cannot_tell_which,
    describe,
    either,
    failed,
)
from omm_core.part_pose.noise_model import NoiseModel, noise_model
from omm_core.part_pose.observation import SolveOptions
from omm_core.part_pose.posterior import (
    Matrices,
    Posterior,
    diagonal_mm,
    noise_matrices,
    posterior,
)
from omm_core.part_pose.problem import Problem
from omm_core.part_pose.snooping import Hypothesis, lost, search
from omm_core.part_pose.statistics import chi2_limit
from omm_core.words import Words

Array = NDArray[np.float64]

_DISPLACED_MM = 1.0
_OFF_PX = 20.0
_SUSPICIOUS = 1.0  # ln B above which something is wrong; 0 is what cannot be checked at all
_TELLS_APART = 3.0  # of ln B
_MOST_LEFT_OUT = 1 / 3
_TRIED = 40  # hypotheses on the whole grid, the most suspicious ones
_WORST_DETECTOR = 5.0  # times what it says of its own noise
_ASTRAY_PX = 20.0  # residuals beyond which the linear problem may be another one


@dataclass(frozen=True, kw_only=True, eq=False)
class BlunderSearch:
    """What the search came to.

    Attributes
    ----------
    fit : PoseFit
        Of the observations that are left; with words where there is none to believe.
    posterior : Posterior or None
        Of these; None where nothing could be computed.
    dropped : (N,) bool array
        Which of the first problem's observations are left out.
    reasons : dict
        Index of observation to why.
    findings : tuple of str
        What was found wrong, for people.
    contradictory : bool
        Whether the residuals are larger than any machine explains.
    """

    fit: PoseFit
    posterior: Posterior | None
    dropped: NDArray[np.bool_]
    reasons: dict[int, Words]
    findings: tuple[Words, ...]
    contradictory: bool = False


def search_blunders(problem: Problem, options: SolveOptions) -> BlunderSearch:
    """Return pose and noise from the observations that are not demonstrably wrong."""
    first = fit(problem, options)
    start = _found(first, problem, options)
    nowhere = first.propagation is None
    if not options.find_errors or (nowhere and not first.unseen and not lost(first)):
        return start
    astray = nowhere or (start.contradictory and _rms_px(start) > _ASTRAY_PX)
    if not astray:
        found = _without_blunders(start, problem, options)
        if not found.contradictory:
            return found
    found = _without_gross(problem, start, options)
    return found if found.contradictory else _without_blunders(found, problem, options)


def _found(
    current: PoseFit, problem: Problem, options: SolveOptions, before: BlunderSearch | None = None
) -> BlunderSearch:
    """Return what is found with a fit, and what was found before it."""
    estimated = None
    if current.propagation is not None and current.best is not None:
        try:
            estimated = posterior(noise_model(current.problem, current.best, options), options)
        except np.linalg.LinAlgError as error:
            current = replace(current, missing=(*current.missing, failed(error)))
    contradictory = estimated is not None and _beyond_machines(estimated.model, options)
    if before is not None:
        return replace(before, fit=current, posterior=estimated, contradictory=contradictory)
    return BlunderSearch(
        fit=current, posterior=estimated, dropped=np.zeros(len(problem), dtype=bool), reasons={},
        findings=(), contradictory=contradictory,
    )  # fmt: skip


def _rms_px(found: BlunderSearch) -> float:
    assert found.fit.propagation is not None
    return float(np.sqrt(np.mean(found.fit.propagation.raw_residuals_px**2)))


def _beyond_machines(model: NoiseModel, options: SolveOptions) -> bool:
    """Return whether the residuals exceed those of the worst machine there may be."""
    m, u = model.redundancy, model.unknowns
    if m < 1:
        return False
    stop_sigma_mm = max(options.worst_machine_mm / 4.0, options.stop_sigma_mm or 0.0)
    geometry_sigma_mm = max(options.worst_machine_mm, options.geometry_sigma_mm or 0.0)
    shortest = geometry_lengths(options, diagonal_mm(model.problem))[:1]
    geometry = model.geometry_covariances(shortest)[1][0]
    C = model.targets + model.calibration + _WORST_DETECTOR**2 * model.image
    C = C + stop_sigma_mm**2 * model.stop_covariance() + geometry_sigma_mm**2 * geometry
    z = model.u_z[u:]
    return bool(z @ np.linalg.solve(C[u:, u:], z) > chi2_limit(m, options.significance))


def _without_gross(problem: Problem, start: BlunderSearch, options: SolveOptions) -> BlunderSearch:
    """Leave out what contradicts even the worst machine, solving without it from nothing."""
    blurred = replace(problem, information=problem.information / _WORST_DETECTOR**2)
    worst = replace(options, stop_sigma_mm=options.worst_machine_mm)
    gross = search(blurred, worst)
    if gross.fit.missing and not gross.fit.unseen:
        return replace(start, fit=replace(gross.fit, problem=problem), contradictory=False)
    if not gross.fit.passed:
        return start
    rest = problem.without(gross.dropped)
    near = gross.fit.minima or None
    found = _found(fit(rest, options, near=near), problem, options)
    return replace(
        found, dropped=gross.dropped, reasons=gross.reasons, findings=gross.findings
    )  # fmt: skip


def _without_blunders(
    found: BlunderSearch, problem: Problem, options: SolveOptions
) -> BlunderSearch:
    """Leave out one error after the other, until nothing is suspicious."""
    while found.posterior is not None and not found.fit.missing:
        suspects = _suspects(found.posterior, found.dropped, options)
        if not suspects:
            return found
        following = _leave_out(suspects, found, problem, options)
        if following.fit.missing:
            return following
        found = following
    return found


def _suspects(
    estimated: Posterior, dropped: NDArray[np.bool_], options: SolveOptions
) -> list[Hypothesis]:
    """Return the best hypothesis and what cannot be told from it, the best first."""
    hypotheses, columns = _hypotheses(estimated.model)
    if not hypotheses or estimated.model.redundancy < 1:
        return []
    log_factors = _log_factors(estimated, columns, options)
    best = float(log_factors.max())
    if not best > _SUSPICIOUS:
        return []
    order = np.argsort(-log_factors, kind="stable")
    chosen = [i for i in order if log_factors[i] > max(best - _TELLS_APART, 0.0)]
    return [_of_all(hypotheses[i], dropped) for i in chosen]


def _of_all(hypothesis: Hypothesis, dropped: NDArray[np.bool_]) -> Hypothesis:
    """Return a hypothesis about what is left as one about all observations."""
    members = np.zeros(len(dropped), dtype=bool)
    members[np.flatnonzero(~dropped)[hypothesis.members]] = True
    return replace(hypothesis, members=members)


def _hypotheses(model: NoiseModel) -> tuple[list[Hypothesis], list[Array]]:
    """Return what may be wrong, each set of observations once, with its columns (k, m)."""
    problem, K = model.problem, model.split[model.unknowns :]
    by_observation = K.reshape(len(K), -1, 2)
    hypotheses: list[Hypothesis] = []
    columns: list[Array] = []
    known: set[bytes] = set()

    def add(hypothesis: Hypothesis) -> None:
        if hypothesis.members.tobytes() in known:
            return
        known.add(hypothesis.members.tobytes())
        rows = np.flatnonzero(hypothesis.members)
        if hypothesis.kind == "target":
            effect = np.einsum("mni,nij->jm", by_observation[:, rows], model.by_point[rows])
            effect *= _DISPLACED_MM
        else:
            effect = np.einsum("mni,nij->njm", by_observation[:, rows], model.whitening[rows])
            effect = effect.reshape(-1, len(K)) * _OFF_PX
        hypotheses.append(hypothesis)
        columns.append(effect)

    for image in np.unique(problem.image_of):
        members = problem.image_of == image
        kind = "observation" if members.sum() == 1 else "image"
        add(Hypothesis(kind=kind, members=members))  # type: ignore[arg-type]
    for target in np.unique(problem.target_of):
        add(Hypothesis(kind="target", members=problem.target_of == target))
    for index in range(len(problem)):
        add(Hypothesis(kind="observation", members=np.arange(len(problem)) == index))
    return hypotheses, columns


def _log_factors(estimated: Posterior, columns: list[Array], options: SolveOptions) -> Array:
    """Return ln B of each hypothesis."""
    model, u = estimated.model, estimated.model.unknowns
    grid, matrices = _doubting(estimated, options)
    own = (matrices.C_0, matrices.C_image, matrices.C_stop, matrices.C_own)
    of_noise = NoiseBlocks(*(np.ascontiguousarray(C[..., u:, u:]) for C in own))
    z = np.ascontiguousarray(model.u_z[u:])
    log_factors = np.full(len(columns), -np.inf)
    chosen = np.arange(len(columns))
    if len(columns) > _TRIED:  # by what they would be on the likeliest machine alone
        likeliest = grid.only(np.array([int(np.argmax(estimated.weight))]))
        alone = _bayes_factors(of_noise, z, likeliest, columns)
        chosen = np.sort(np.argsort(-alone, kind="stable")[:_TRIED])
    log_factors[chosen] = _bayes_factors(of_noise, z, grid, [columns[i] for i in chosen])
    return log_factors


def _doubting(estimated: Posterior, options: SolveOptions) -> tuple[NoiseGrid, Matrices]:
    """Return the grid with even odds that what is declared of the machine does not hold.

    Where a machine is less exact than declared, its noise is not to be taken for a blunder.
    """
    free = replace(options, stop_sigma_mm=None, geometry_sigma_mm=None, geometry_length_mm=None)
    if free == options:
        return estimated.grid, estimated.matrices
    grid = both_grids(estimated.grid, posterior(estimated.model, free).grid)
    return grid, noise_matrices(estimated.model, grid)


def _bayes_factors(of_noise: NoiseBlocks, z: Array, grid: NoiseGrid, columns: list[Array]) -> Array:
    first = np.cumsum([0, *(len(of) for of in columns)]).astype(np.int64)
    log_factors = np.empty(len(columns))
    bayes_factors(
        of_noise, z, grid.machines(), np.ascontiguousarray(np.concatenate(columns)), first,
        log_factors,
    )  # fmt: skip
    return log_factors


def _leave_out(
    suspects: list[Hypothesis], found: BlunderSearch, problem: Problem, options: SolveOptions
) -> BlunderSearch:
    """Return what is left without all that is suspected, or words where that is too little."""
    union = np.any([suspect.members for suspect in suspects], axis=0)
    dropped = found.dropped | union
    near = found.fit.minima or None
    most = max(1, int(len(problem) * _MOST_LEFT_OUT))
    rest = fit(problem.without(dropped), options, near=near) if dropped.sum() <= most else None
    enough = rest is not None and rest.determined and rest.degrees_of_freedom >= 1
    told_by = rest if enough and rest is not None else found.fit
    words = [describe(problem, s.members, s.kind, told_by) for s in suspects[:3]]
    if not enough or rest is None:
        missing = cannot_tell_which(words) if len(words) > 1 else cannot_leave_out(words[0])
        return replace(found, fit=replace(found.fit, missing=(missing,)))
    told = either(words)
    reasons = found.reasons | {int(index): told for index in np.flatnonzero(union)}
    before = replace(found, dropped=dropped, reasons=reasons, findings=(*found.findings, told))
    return _found(rest, problem, options, before)
