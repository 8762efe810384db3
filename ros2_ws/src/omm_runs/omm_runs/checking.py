"""Checks an old calibration against a new run, with what the run itself was measured with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from omm_core.camera_calibration.check import CalibrationCheck, check_calibration
from omm_core.part_pose import SolveOptions
from omm_runs.solving import SolvedRun, SolveRunOptions, solve_run


@dataclass(frozen=True, kw_only=True, eq=False)
class CheckedRun:
    """A run and what it says of the calibration."""

    solved: SolvedRun
    check: CalibrationCheck


def check_run(run: Path, options: SolveRunOptions) -> CheckedRun:
    """Test the calibration of a run, or the one that the options name.

    Raises
    ------
    InputError
        If a file cannot be used.
    MeasurementError
        If the run does not determine the part's pose.
    """
    solved = solve_run(run, options)
    solution = solved.result.solution
    settings = SolveOptions(model=solution.model)  # type: ignore[arg-type]
    if solved.machine is not None:
        settings = settings.of_machine(solved.machine.uncertainty)
    check = check_calibration(solution.observations, solved.part, solved.calibration, settings)
    return CheckedRun(solved=solved, check=check)
