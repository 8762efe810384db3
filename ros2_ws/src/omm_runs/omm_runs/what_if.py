"""What would help: a budget computed again with one thing better, at its worst point and axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.budget import Budget
from omm_core.budget.evaluation import Contribution, combine
from omm_core.budget.sources import part_T_survey, pose_covariances
from omm_core.errors import InputError
from omm_core.files.json_input import read_json
from omm_core.files.part import Part
from omm_core.files.points import load_points
from omm_core.part_pose import SolveOptions, solve
from omm_runs.budgeting import BudgetSources
from omm_runs.solving import SolvedRun

Array = NDArray[np.float64]
_SMALLEST_GAIN = 0.005


@dataclass(frozen=True, kw_only=True)
class WhatIf:
    """One thing done better: U at the worst point's worst axis falls by ``gain`` (0.12: 12 %)."""

    what: str
    gain: float


def what_ifs(sources: BudgetSources, budget: Budget) -> tuple[WhatIf, ...]:
    """Return what would help, the most helpful first; what helps less than 0.5 % is left out."""
    found = [
        *_halved(budget, of_a_run=sources.run is not None and sources.campaign is None),
        *_of_the_run(sources, budget),
        *_of_the_survey(sources, budget),
    ]
    helpful = [one for one in found if one.gain >= _SMALLEST_GAIN]
    return tuple(sorted(helpful, key=lambda one: -one.gain))


def _gain(budget: Budget, changed: Sequence[Contribution]) -> float:
    """Return by how much U falls with other contributions."""
    combined = combine(changed, budget.correlation)
    expanded = budget.coverage.factors(combined) * combined.standard_uncertainty_mm
    at = budget.worst
    if budget.expanded_mm[at] == 0.0:
        return 0.0
    return float(1.0 - expanded[at] / budget.expanded_mm[at])


def _scaled(
    budget: Budget, chosen: Callable[[Contribution], bool], factor: float | Array
) -> list[Contribution]:
    return [
        replace(one, millimetres=one.millimetres * factor) if chosen(one) else one
        for one in budget.contributions
    ]


def _halved(budget: Budget, *, of_a_run: bool) -> list[WhatIf]:
    words = {} if of_a_run else {"u_ip": "the pose in the machine known twice as well"}
    words |= {
        "u_it": "the part's temperature known twice as well",
        "u_machine": "a machine twice as exact where the tool goes",
    }
    found = [
        WhatIf(what=what, gain=_gain(budget, _scaled(budget, _is_of(group), 0.5)))
        for group, what in words.items()
    ]
    lme = any(c.group == "u_out" and c.shape.kind == "uniform" for c in budget.contributions)
    out = "a survey with half the length error" if lme else "a survey twice as good"
    found.append(WhatIf(what=out, gain=_gain(budget, _scaled(budget, _is_of("u_out"), 0.5))))
    for one in budget.contributions:
        if one.group == "other":
            changed = _scaled(budget, _is(one.name), 0.5)
            found.append(WhatIf(what=f"half of {one.name}", gain=_gain(budget, changed)))
    return found


def _is_of(group: str) -> Callable[[Contribution], bool]:
    return lambda one: one.group == group


def _is(name: str) -> Callable[[Contribution], bool]:
    return lambda one: one.name == name


def _of_the_run(sources: BudgetSources, budget: Budget) -> list[WhatIf]:
    """Solve the run again with more images, and better targets, camera, machine.

    The machine counts as this run shows it, so that only what is changed changes anything.
    """
    run = sources.run
    if run is None or sources.campaign is not None or run.result.solution.machine is None:
        return []
    base = _covariance(run)
    better_camera = replace(run.calibration, covariance=run.calibration.covariance / 4.0)
    cases = {
        "twice the images in the machine": _covariance(run, twice=True),
        "the camera calibrated twice as well": _covariance(run, calibration=better_camera),
        "targets known twice as well": _covariance(run, part=_better_targets(run.part)),
        "a machine twice as exact at the stops": _covariance(run, machine=0.5),
    }
    xyz = np.array([point.xyz_mm for point in budget.points])
    theta = run.result.solution.theta.tolist()
    before = _sigmas(theta, base, xyz)
    found = []
    for what, covariance in cases.items():
        ratio = _sigmas(theta, covariance, xyz) / np.where(before > 0.0, before, 1.0)
        found.append(WhatIf(what=what, gain=_gain(budget, _scaled(budget, _is("u_ip"), ratio))))
    return found


def _sigmas(theta: Sequence[float], covariance: Array, xyz: Array) -> Array:
    return np.sqrt(np.einsum("pii->pi", pose_covariances(theta, covariance, xyz)))


def _covariance(  # type: ignore[no-untyped-def]
    run: SolvedRun, *, twice: bool = False, machine: float = 1.0, part=None, calibration=None
) -> Array:
    """Return the covariance of θ for a known machine, without what residuals do to it."""
    solution = run.result.solution
    noise = solution.machine
    assert noise is not None  # the caller has looked
    used = [o for o, use in zip(solution.observations, solution.used) if use]
    if twice:
        # The program once more: images that follow each other at one place would be one stop.
        stamps = [o.stamp_ns for o in used]
        later = max(stamps) - min(stamps) + 1
        used += [replace(o, stamp_ns=o.stamp_ns + later) for o in used]
    options = SolveOptions(
        model="6d" if solution.model == "6d" else "7d",
        gamma_s_rad=float(solution.theta[6]) if solution.model == "6d" else 0.0,
        stop_sigma_mm=noise.stop_sigma_mm.median * machine,
        geometry_sigma_mm=noise.geometry_sigma_mm.median * machine,
        geometry_length_mm=noise.geometry_length_mm.median or None,
        trust_detector=True,
        find_errors=False,
    )
    solved = solve(used, part or run.part, calibration or run.calibration, options)
    return np.asarray(solved.covariance / solved.covariance_factor)


def _better_targets(part: Part) -> Part:
    targets = tuple(
        target
        if target.sigma_xyz_mm is None
        else replace(target, sigma_xyz_mm=target.sigma_xyz_mm / 2.0)
        for target in part.targets
    )
    covariance = None if part.covariance_mm2 is None else part.covariance_mm2 / 4.0
    return replace(part, targets=targets, covariance_mm2=covariance)


def _of_the_survey(sources: BudgetSources, budget: Budget) -> list[WhatIf]:
    """Return what more photographs and a second scale bar would do to u_out.

    The scale's variance is what the survey's full covariance has along "all points farther from
    their middle": a second bar as good as the first halves it.
    """
    given = sources.file.u_out
    if given is None or given.points is None:
        return []
    loaded = full_covariance(given.points)
    if loaded is None:
        return []
    names, covariance = loaded
    survey = load_points(given.points)
    by_name = {point.name: point.xyz_mm for point in survey.points}
    if any(name not in by_name for name in names):
        return []
    places = np.array([by_name[name] for name in names])
    middle = places.mean(axis=0)
    along = (places - middle).reshape(-1)
    square = float(along @ along)
    scale = float(along @ covariance @ along) / square**2
    transform, _ = part_T_survey(sources.part, survey)
    turned = sources.machine_T_part.rotation
    xyz = np.array([point.xyz_mm for point in budget.points])
    if transform is not None:
        turned = turned @ transform.rotation
        xyz = transform.inverse() @ xyz
    stretched = ((xyz - middle) @ turned.T) ** 2 * scale
    before = np.sum([c.millimetres**2 for c in budget.contributions if c.group == "u_out"], axis=0)
    scale_part = np.minimum(stretched, before)
    cases = {
        "a second scale bar": before - scale_part / 2.0,
        "twice the photographs of the survey": scale_part + (before - scale_part) / 2.0,
    }
    return [
        WhatIf(
            what=what,
            gain=_gain(
                budget,
                _scaled(budget, _is_of("u_out"), np.sqrt(after / np.where(before > 0, before, 1))),
            ),
        )
        for what, after in cases.items()
    ]


def full_covariance(points: Path) -> tuple[list[str], Array] | None:
    """Return the names and the full covariance (3 N, 3 N) that points.json names, or None.

    Raises
    ------
    InputError
        Where the file that is named cannot be used.
    """
    told = read_json(points, "points file").get("full_covariance")
    if not isinstance(told, dict) or "file" not in told or "order" not in told:
        return None
    path = points.parent / str(told["file"])
    names = [str(name) for name in told["order"]]
    try:
        matrix = np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise InputError(f"The survey's covariance {path} cannot be read: {error}.") from None
    if matrix.shape != (3 * len(names),) * 2 or not np.isfinite(matrix).all():
        raise InputError(
            f"{path}: expected a covariance of {len(names)} points, got the shape {matrix.shape}."
        )
    return names, np.asarray(matrix, dtype=float)
