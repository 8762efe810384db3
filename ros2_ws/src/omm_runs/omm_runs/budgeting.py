"""A budget.yaml with the runs, the survey and the machine that it names, evaluated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.box_map import BoxMap, grid_of
from omm_core.budget.budget import Budget, Coverage, evaluate
from omm_core.budget.budget_file import BudgetFile, NamedPoint, load_budget_file
from omm_core.budget.campaign import Campaign, mean_theta, point_studies
from omm_core.budget.evaluation import Contribution, combine
from omm_core.budget.sources import (
    box_points,
    constant,
    expansion,
    from_covariances,
    from_studies,
    length_error,
    of_contributor,
    pose_covariances,
    survey_covariances,
)
from omm_core.errors import MeasurementError
from omm_core.files.machine import MachineUncertainty, load_machine
from omm_core.files.part import Part, load_part
from omm_core.files.points import load_points
from omm_core.geometry import RigidTransform
from omm_runs.budget_machine import as_estimated, machine_contribution
from omm_runs.campaigning import campaign_of
from omm_runs.solving import SolvedRun, SolveRunOptions, solve_run

Array = NDArray[np.float64]
_LARGE = 0.01  # of the part's diagonal


@dataclass(frozen=True, kw_only=True, eq=False)
class BudgetSources:
    """What a budget is evaluated from: everything read and solved, once for all points.

    Attributes
    ----------
    machine_T_part : RigidTransform
        Of the run, or the campaign's mean; without them the part's nominal place, else the
        machine's axes.
    """

    file: BudgetFile
    part: Part
    run: SolvedRun | None
    campaign: Campaign | None
    machine: MachineUncertainty | None
    machine_T_part: RigidTransform
    findings: tuple[str, ...]


def load_sources(path: Path) -> BudgetSources:
    """Read budget.yaml and what it names.

    Raises
    ------
    InputError
        Where a file cannot be used.
    MeasurementError
        Where the run has no result.
    """
    file = load_budget_file(path)
    part = load_part(file.part)
    given = file.u_ip
    run = _solved(given.run, file.machine) if given is not None and given.run is not None else None
    campaign = None
    if given is not None and given.campaign is not None:
        campaign, _ = campaign_of(given.campaign)
    findings = [
        f"{name} is not given and counts as 0"
        for name in ("u_ip", "u_it", "u_out")
        if getattr(file, name) is None
    ]
    if run is not None:
        alpha, beta, gamma, *shift = run.result.solution.theta[:6].tolist()
        placed = RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, shift)
        said = (*run.result.findings, *run.result.solution.remarks)
        findings += [f"run: {words.rstrip('.')}" for words in said]
    elif campaign is not None:
        alpha, beta, gamma, *shift = mean_theta(campaign.measured)[:6].tolist()
        placed = RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, shift)
    else:
        placed = _nominal(part)
    machine = None
    if file.machine is not None:
        machine, words = as_estimated(load_machine(file.machine).uncertainty, run)
        findings += words
    return BudgetSources(
        file=file,
        part=part,
        run=run,
        campaign=campaign,
        machine=machine,
        machine_T_part=placed,
        findings=tuple(findings),
    )


def budget_of(path: Path) -> Budget:
    """Evaluate a budget.yaml at its points."""
    return budget_from(load_sources(path))


def budget_from(sources: BudgetSources) -> Budget:
    """Evaluate a budget at the points that its file names."""
    return budget_at(sources, sources.file.points or box_points(sources.part))


def budget_at(sources: BudgetSources, points: Sequence[NamedPoint]) -> Budget:
    """Evaluate a budget at points of the part."""
    file = sources.file
    contributions, findings = contributions_at(sources, points)
    correlation, told = _correlation(file, contributions)
    if file.tolerance_mm is None and any(point.deviation_mm is not None for point in points):
        told = (*told, "a deviation_mm is given, but no tolerance_mm: nothing is decided")
    budget = evaluate(
        points,
        contributions,
        correlation=correlation,
        coverage=_coverage(file),
        tolerance_mm=file.tolerance_mm,
        findings=(*sources.findings, *findings, *told),
    )
    return replace(budget, findings=(*budget.findings, *_doubts(budget, sources.part)))


def _doubts(budget: Budget, part: Part) -> tuple[str, ...]:
    """Say where U is so small or so large that a unit may be wrong."""
    largest = float(budget.expanded_mm.max())
    if largest == 0.0:
        return ("all that is given is 0 or cancels: U is 0, which no measurement has",)
    size = float(np.linalg.norm(np.ptp(part.box(), axis=0)))
    if largest > _LARGE * size > 0.0:
        return (
            f"U of {largest:.4g} mm on a part of {size:.4g} mm: see whether all units are right",
        )
    return ()


def map_of(sources: BudgetSources, steps: int = 9) -> BoxMap:
    """Return U_total over the part's box, by the GUM, on a grid of so many steps each way."""
    axes, grid = grid_of(sources.part.box(), steps)
    expanded = expanded_at(sources, grid.reshape(-1, 3))
    return BoxMap(axes_mm=axes, expanded_mm=expanded.reshape(grid.shape))


def expanded_at(sources: BudgetSources, xyz_mm: Array) -> Array:
    """Return U_total by the GUM at points (P, 3) of the part, (P, 3) mm along machine X Y Z."""
    points = [NamedPoint(name="", xyz_mm=xyz) for xyz in xyz_mm]
    contributions, _ = contributions_at(sources, points)
    combined = combine(contributions, _correlation(sources.file, contributions)[0])
    return _coverage(sources.file).factors(combined) * combined.standard_uncertainty_mm


def _correlation(
    file: BudgetFile, contributions: Sequence[Contribution]
) -> tuple[dict[tuple[str, str], float], tuple[str, ...]]:
    """Return the correlations of contributors that are there, and words on the others."""
    names = {one.name for one in contributions}
    counted, findings = {}, []
    for one in file.contributors:
        for other, r in one.correlation.items():
            if other in names:
                counted[one.name, other] = r
            else:
                findings.append(
                    f"{one.name} is correlated with {other}, of which there is no contributor:"
                    " that is not counted"
                )
    return counted, tuple(findings)


def _coverage(file: BudgetFile) -> Coverage:
    return Coverage(factor=file.coverage_factor, probability=file.coverage_probability)


def contributions_at(
    sources: BudgetSources, points: Sequence[NamedPoint]
) -> tuple[list[Contribution], tuple[str, ...]]:
    """Return all contributions at points of the part, and what is to be said of them."""
    file = sources.file
    xyz = np.array([point.xyz_mm for point in points])
    rotation = sources.machine_T_part.rotation
    places = xyz @ rotation.T
    found: list[Contribution] = []
    findings: list[str] = []
    if file.u_ip is not None:
        one, told = _in_part(sources, xyz, places)
        found.append(one)
        findings += told
    if file.u_it is not None:
        found += expansion(file.u_it, places)
    if file.u_out is not None:
        if file.u_out.points is not None:
            in_part, told = survey_covariances(points, sources.part, load_points(file.u_out.points))
            findings += told
            turned = rotation @ in_part @ rotation.T
            found.append(from_covariances("u_out", "u_out", turned, np.inf))
        elif file.u_out.sigma_mm is not None:
            found.append(constant("u_out", "u_out", file.u_out.sigma_mm, places, "normal"))
        else:
            found.append(length_error(file.u_out.constant_mm, file.u_out.per_metre_mm, places))
    if sources.machine is not None:
        added, words = machine_contribution(
            sources.machine, sources.run, sources.machine_T_part, xyz, file.tool_mm
        )
        found.append(added)
        findings += words
    found += [of_contributor(one, places) for one in file.contributors]
    return found, tuple(findings)


def _in_part(
    sources: BudgetSources, xyz: Array, places: Array
) -> tuple[Contribution, tuple[str, ...]]:
    """Return u_ip: of the run's covariance, of the campaign, or the larger of both, or as given."""
    given = sources.file.u_ip
    assert given is not None  # only called then
    found, told = [], []
    if given.sigma_mm is not None:
        found.append(constant("u_ip", "u_ip", given.sigma_mm, places, "normal"))
    if sources.run is not None:
        solution = sources.run.result.solution
        covariances = pose_covariances(solution.theta.tolist(), solution.covariance, xyz)
        found.append(from_covariances("u_ip", "u_ip", covariances, np.inf))
    if sources.campaign is not None:
        found.append(from_studies(point_studies(sources.campaign.measured, xyz)))
        if sources.campaign.clampings == 1:
            told.append("u_ip: a campaign of one clamping does not show what clampings add")
    if len(found) == 1:
        return found[0], tuple(told)
    told.append("u_ip: of what is given, the largest counts at each point and axis")
    each = np.array([one.millimetres for one in found])
    freedom = np.array([one.degrees_of_freedom() for one in found])
    largest = each.argmax(axis=0)[None]
    return (
        replace(
            found[0],
            millimetres=np.take_along_axis(each, largest, 0)[0],
            freedom=np.take_along_axis(freedom, largest, 0)[0],
        ),
        tuple(told),
    )


def _solved(path: Path, machine: Path | None) -> SolvedRun:
    solved = solve_run(path, SolveRunOptions(machine_file=machine))
    result = solved.result
    if not result.determined or not result.solution.converged:
        reasons = "; ".join([*result.missing, *result.findings])
        raise MeasurementError(f"{path} has no result for u_ip: {reasons}.")
    return solved


def _nominal(part: Part) -> RigidTransform:
    """Return where the part is wanted; what is "anywhere" counts as 0."""
    if part.nominal is None:
        return RigidTransform.identity()
    alpha, beta, gamma = (value or 0.0 for value in part.nominal.euler_xyz_rad)
    shift = [value or 0.0 for value in part.nominal.translation_mm]
    return RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, translation_mm=shift)
