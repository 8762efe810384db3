"""The runs of a campaign.yaml: solved on all cores, and evaluated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from omm_core.budget.campaign import Campaign, MeasuredRun, evaluate_campaign
from omm_core.budget.campaign_file import CampaignFile, load_campaign_file
from omm_core.errors import InputError, MeasurementError
from omm_core.files.part import Part
from omm_core.part_pose import SolveOptions, solve
from omm_runs.solving import SolveRunOptions, solve_run
from omm_runs.spreading import spread

_SAME_MM = 1e-6


@dataclass(frozen=True, kw_only=True)
class _Task:
    run: Path
    clamping: int
    repeat: int
    part: Path | None
    calibration: Path | None


def campaign_of(
    path: Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Campaign, Part]:
    """Solve the runs that a campaign.yaml names, and evaluate them.

    With a scheduler, the paths must hold for its workers, too.

    Raises
    ------
    InputError
        Where a file cannot be used.
    MeasurementError
        Where a run has no result: a campaign is not evaluated with a run missing.
    """
    file = load_campaign_file(path)
    solved = spread(_solved, _tasks(file), jobs=jobs, scheduler=scheduler, progress=progress)
    part = solved[0][1]
    _expect_one_part([(measured.name, own) for measured, own, _ in solved])
    _expect_no_copies([measured for measured, _, _ in solved])
    campaign = evaluate_campaign(
        [measured for measured, _, _ in solved],
        tolerances={**full_widths(part), **file.tolerances},
        reference=file.reference,
    )
    cameras = {camera for _, _, camera in solved}
    if len(cameras) > 1:
        told = (
            f"the runs were solved with {len(cameras)} different calibrations: these scatter, too"
        )
        campaign = replace(campaign, findings=(*campaign.findings, told))
    return campaign, part


def _expect_one_part(parts: Sequence[tuple[str, Part]]) -> None:
    """Refuse runs of different parts: their poses have nothing in common."""
    first, part = parts[0]
    wanted = {target.id: target.xyz_mm for target in part.targets}
    for name, other in parts[1:]:
        own = {target.id: target.xyz_mm for target in other.targets}
        if own.keys() != wanted.keys() or any(
            np.linalg.norm(own[id] - wanted[id]) > _SAME_MM for id in wanted
        ):
            raise InputError(
                f"Expected runs of one part that stood still, but the targets of {name} are not"
                f" those of {first}."
            )


def _expect_no_copies(measured: Sequence[MeasuredRun]) -> None:
    """Refuse the same recording under two names: noise never comes twice to the last digit."""
    seen: dict[bytes, str] = {}
    for one in measured:
        other = seen.setdefault(one.theta.tobytes(), one.name)
        if other != one.name:
            raise InputError(
                f"Expected each measurement once, but {one.name} gives the same as {other} to the"
                " last digit: is it a copy?"
            )


def full_widths(part: Part) -> Mapping[str, float]:
    """Return the part's tolerances (plus/minus) as full widths."""
    return {name: 2.0 * half for name, half in part.tolerances.items()}


def _tasks(file: CampaignFile) -> list[_Task]:
    return [
        _Task(
            run=one.run,
            clamping=one.clamping,
            repeat=one.repeat,
            part=file.part,
            calibration=file.calibration,
        )
        for one in file.runs
    ]


def _solved(task: _Task) -> tuple[MeasuredRun, Part, tuple[float, ...]]:
    """Return what a run measured, of which part, and the calibration it was solved with."""
    options = SolveRunOptions(part_file=task.part, calibration_file=task.calibration, threads=1)
    run = solve_run(task.run, options)
    solution = run.result.solution
    if not run.result.determined or not solution.converged:
        reasons = "; ".join([*run.result.missing, *run.result.findings]) or "does not converge"
        raise MeasurementError(f"{task.run} has no result: {reasons}.")
    used = [o for o, use in zip(solution.observations, solution.used) if use]
    # Backlash makes 6D's residuals large: nothing is left out or refused for that here.
    six = solve(used, run.part, run.calibration, SolveOptions(model="6d", find_errors=False))
    measured = MeasuredRun(
        clamping=task.clamping,
        repeat=task.repeat,
        theta=np.array(solution.theta),
        covariance=np.array(solution.covariance),
        theta_6d=np.array(six.theta) if six.determined else None,
        name=str(task.run),
    )
    camera = run.calibration
    return measured, run.part, tuple(camera.parameter_values(camera.parameter_names()).tolist())
