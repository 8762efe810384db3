"""The runs of a campaign.yaml solved, all cores at it, and evaluated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from omm_core.budget.campaign import Campaign, Measured, evaluate_campaign
from omm_core.budget.campaign_file import CampaignFile, load_campaign_file
from omm_core.errors import MeasurementError
from omm_core.files.part import Part
from omm_core.part_pose import SolveOptions, solve
from omm_runs.solving import SolveRunOptions, solve_run
from omm_runs.spreading import spread


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
        Where a run has no result: a campaign with a hole is none.
    """
    file = load_campaign_file(path)
    solved = spread(_solved, _tasks(file), jobs=jobs, scheduler=scheduler, progress=progress)
    part = solved[0][1]
    campaign = evaluate_campaign(
        [measured for measured, _ in solved],
        tolerances={**full_widths(part), **file.tolerances},
        reference=file.reference,
    )
    return campaign, part


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


def _solved(task: _Task) -> tuple[Measured, Part]:
    options = SolveRunOptions(part_file=task.part, calibration_file=task.calibration, threads=1)
    run = solve_run(task.run, options)
    solution = run.result.solution
    if not run.result.determined or not solution.converged:
        reasons = "; ".join([*run.result.missing, *run.result.findings]) or "does not converge"
        raise MeasurementError(f"{task.run} has no result: {reasons}.")
    used = [o for o, use in zip(solution.observations, solution.used) if use]
    # Backlash makes 6D's residuals large: nothing is left out or refused for that here.
    six = solve(used, run.part, run.calibration, SolveOptions(model="6d", find_errors=False))
    measured = Measured(
        clamping=task.clamping,
        repeat=task.repeat,
        theta=np.array(solution.theta),
        covariance=np.array(solution.covariance),
        theta_6d=np.array(six.theta) if six.determined else None,
        name=str(task.run),
    )
    return measured, run.part
