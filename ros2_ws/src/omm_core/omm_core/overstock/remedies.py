"""Where no placement leaves enough material: what would have to be given up, and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from omm_core.overstock.placement_state import PlacementState
from omm_core.overstock.problem import Problem, Settled

Array = NDArray[np.float64]
ROUNDS = 4
NOTHING_MM = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Remedies:
    """By how much allowances would have to be lowered, mm.

    Attributes
    ----------
    alone : dict
        One group's allowance alone, by the group's number; groups where that cannot help are
        not in it.
    least : dict
        The least in sum, by the group's number.
    """

    alone: dict[int, float]
    least: dict[int, float]

    @property
    def sum_mm(self) -> float:
        """Return the least sum of all allowances lowered."""
        return sum(self.least.values())


def find_remedies(problem: Problem, settled: Settled) -> Remedies:
    """Return what would make a placement with negative margins possible."""
    groups = np.unique(settled.wish.groups[~settled.wish.is_aside])
    least = _lowered(problem, settled, groups)
    alone: dict[int, float] = {}
    limiting = settled.placement.limiting
    for group in groups:
        if limiting[settled.wish.groups == group].sum() > 1e-6 or group in (least or {}):
            one = _lowered(problem, settled, np.array([group]))
            if one is not None:
                alone[int(group)] = one.get(int(group), 0.0)
    return Remedies(alone=alone, least=least or {})


def _lowered(
    problem: Problem, settled: Settled, groups: NDArray[np.int64]
) -> dict[int, float] | None:
    """Return the least sum of lowered allowances of these groups; None where they do not help."""
    pose, lowered = settled.placement.pose, np.zeros(len(groups))
    for _ in range(ROUNDS):
        state = PlacementState(
            settled.points.xyz,
            lambda placed: problem.surfaces(settled.face, placed),
            problem.file.target_thickness_mm,
            settled.wish,
            pose,
        )
        counted = np.isfinite(state.margins)
        member = (settled.wish.groups[:, None] == groups[None]).astype(float)[counted]
        limits = np.zeros((len(state.limits), len(groups)))
        rows = np.vstack(
            [
                np.hstack([-state.jacobian[counted] @ state.freedom, -member]),
                np.hstack([-state.limit_rows @ state.freedom, limits]),
            ]
        )
        free = state.freedom.shape[1]
        reach = 0.2 * state.size
        answer = linprog(
            np.concatenate([np.zeros(free), np.ones(len(groups))]),
            A_ub=rows,
            b_ub=np.concatenate([state.margins[counted], state.limits]),
            bounds=[(-reach, reach)] * free + [(0.0, None)] * len(groups),
            method="highs",
        )
        if answer.x is None:
            return None
        step, lowered = state.freedom @ answer.x[:free], answer.x[free:]
        pose = state.moved(step)
        if np.abs(step).max() < NOTHING_MM:
            break
    return {int(g): float(v) for g, v in zip(groups, lowered, strict=True) if v > NOTHING_MM}
