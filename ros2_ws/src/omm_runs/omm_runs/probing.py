"""Probed points against the pose of a run, with what else a budget knows of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.budget_file import NamedPoint
from omm_core.budget.probing import ProbingCheck, check_probing
from omm_core.errors import MeasurementError
from omm_core.files.probed import ProbedPoint
from omm_runs.budgeting import budget_at, load_sources
from omm_runs.solving import SolveRunOptions, solve_run


def check_run(
    run: Path,
    points: Sequence[ProbedPoint],
    *,
    options: SolveRunOptions | None = None,
    budget: Path | None = None,
) -> ProbingCheck:
    """Solve a run and compare probed points with its pose.

    Parameters
    ----------
    budget : path, optional
        A budget.yaml whose contributors other than u_ip count for the points, too.

    Raises
    ------
    MeasurementError
        Where the run has no result.
    """
    solved = solve_run(run, options)
    result = solved.result
    if not result.determined or not result.solution.converged:
        reasons = "; ".join([*result.missing, *result.findings])
        raise MeasurementError(f"{run} has no pose to probe against: {reasons}.")
    extra = None if budget is None else _without_u_ip(budget, points)
    theta = result.solution.theta
    return check_probing(points, theta.tolist(), result.solution.covariance, extra_sigma_mm=extra)


def _without_u_ip(path: Path, points: Sequence[ProbedPoint]) -> NDArray[np.float64]:
    """Return what the budget says of the points besides u_ip, (N, 3)."""
    named = [NamedPoint(name=point.name, xyz_mm=point.part_mm) for point in points]
    evaluated = budget_at(load_sources(path), named)
    total = evaluated.combined.standard_uncertainty_mm
    u_ip = np.sum([c.millimetres**2 for c in evaluated.contributions if c.group == "u_ip"], axis=0)
    return np.asarray(np.sqrt(np.clip(total**2 - u_ip, 0.0, None)))
