"""Where the ideal part lies in the raw one: the largest smallest margin, group by group.

Point p with outward normal n and foot q on its nominal face has the overstock
``a(T) = n · (T p - q) - thickness`` and the margin ``a - required``. For a small motion
x = (translation, rotation times size) about the centroid, a is linear, and the largest smallest
margin is a linear programme; steps are bounded by a trust region and taken where the margin as
recomputed from the surfaces grows. The multipliers of the last programme say which groups
limit: the smallest margin is their weighted sum whatever the placement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
# Points in the part frame (N, 3) -> distance outside each point's own face (N,), normals (N, 3).
Surfaces = Callable[[Array], tuple[Array, Array]]

SMALLEST_STEP_MM = 1e-10
ROUNDS = 60
MULTIPLIER = 1e-7


@dataclass(frozen=True, kw_only=True, eq=False)
class Placement:
    """A placement of the survey's points in the part frame.

    Attributes
    ----------
    rotation : (3, 3) array
        part_R_survey.
    translation_mm : (3,) array
        part_T_survey's translation.
    margins_mm : (N,) array
        Overstock minus what is required, per point.
    jacobian : (N, 6) array
        Of the margins in (translation, rotation times size) about the centroid, part frame.
    size_mm : float
        What the rotation was multiplied by.
    limiting : (N,) array
        Multipliers of the smallest margin (sum 1); zero where a point does not limit.
    free : (K, 6) array
        Motions that no point holds.
    """

    rotation: Array
    translation_mm: Array
    margins_mm: Array
    jacobian: Array
    size_mm: float
    limiting: Array
    free: Array

    @property
    def smallest_mm(self) -> float:
        """Return the smallest margin."""
        return float(self.margins_mm.min())


class _State:
    """Margins and their derivatives at a placement."""

    def __init__(
        self, points: Array, surfaces: Surfaces, offset: Array, pose: tuple[Array, Array]
    ) -> None:
        self.pose = pose
        placed = points @ pose[0].T + pose[1]
        distance, normals = surfaces(placed)
        self.margins = distance - offset
        self.centre = placed.mean(axis=0)
        arms = placed - self.centre
        self.size = max(float(np.sqrt((arms**2).sum(axis=1).mean())), 1e-9)
        self.jacobian = np.hstack([normals, np.cross(arms, normals) / self.size])

    def moved(self, step: Array) -> tuple[Array, Array]:
        """Return the pose after a small motion."""
        turn = Rotation.from_rotvec(step[3:] / self.size).as_matrix()
        rotation, translation = self.pose
        return turn @ rotation, turn @ (translation - self.centre) + self.centre + step[:3]


def place_evenly(
    points: Array,
    surfaces: Surfaces,
    *,
    required_mm: Array,
    groups: Array,
    thickness_mm: float = 0.0,
    rotation: Array | None = None,
    translation_mm: Array | None = None,
) -> Placement:
    """Return the placement with the largest smallest margin, then group by group.

    Parameters
    ----------
    points : (N, 3) array
        Centres of the foils, survey frame, mm.
    surfaces : function
        Distance outside each point's face and its outward normal, from places in the part frame.
    required_mm : (N,) array
        Allowance of each point's group.
    groups : (N,) array of int
        Group of each point.
    thickness_mm : float
        Of the foil.
    rotation, translation_mm : (3, 3), (3,) arrays
        Start, part_T_survey.
    """
    offset = required_mm + thickness_mm
    pose = (
        np.eye(3) if rotation is None else rotation,
        np.zeros(3) if translation_mm is None else translation_mm,
    )
    floor = np.full(len(points), np.nan)
    limiting = np.zeros(len(points))
    while np.isnan(floor).any():
        open_ = np.isnan(floor)
        state, multipliers, margin = _raise_smallest(points, surfaces, offset, pose, floor)
        pose = state.pose
        if not limiting.any():
            limiting = multipliers
        fixed = {int(g) for g in np.unique(groups[open_ & (multipliers > MULTIPLIER)])}
        if not fixed:
            break
        floor[open_ & np.isin(groups, list(fixed))] = margin
    state = _State(points, surfaces, offset, pose)
    _, values, axes = np.linalg.svd(state.jacobian, full_matrices=True)
    rank = int((values > 1e-6 * values[0]).sum())
    return Placement(
        rotation=pose[0],
        translation_mm=pose[1],
        margins_mm=state.margins,
        jacobian=state.jacobian,
        size_mm=state.size,
        limiting=limiting,
        free=axes[rank:],
    )


def _raise_smallest(
    points: Array,
    surfaces: Surfaces,
    offset: Array,
    pose: tuple[Array, Array],
    floor: Array,
) -> tuple[_State, Array, float]:
    """Raise the smallest margin of the points without a floor; the others keep theirs."""
    open_ = np.isnan(floor)
    state = _State(points, surfaces, offset, pose)
    radius = 0.1 * state.size
    multipliers = np.zeros(len(points))
    for _ in range(ROUNDS):
        step, multipliers, promised = _programme(state, floor, radius)
        trial = _State(points, surfaces, offset, state.moved(step))
        length = float(np.abs(step).max())
        broken = np.nanmin(np.append(trial.margins[~open_] - floor[~open_], 0.0))
        before = np.nanmin(np.append(state.margins[~open_] - floor[~open_], 0.0))
        gain = trial.margins[open_].min() - state.margins[open_].min() + 10.0 * (broken - before)
        if gain >= 0.0:
            state = trial
            if length < 1e-9:
                break
            radius *= 2.0
        else:
            radius = 0.25 * min(radius, length)
        if radius < SMALLEST_STEP_MM or (promised < 1e-12 and broken > -1e-12):
            break
    return state, multipliers, float(state.margins[open_].min())


def _programme(state: _State, floor: Array, radius: float) -> tuple[Array, Array, float]:
    """Solve the linear programme: step, multipliers of the open points, promised gain."""
    open_ = np.isnan(floor)
    now = float(state.margins[open_].min())
    rows = np.hstack([-state.jacobian, open_[:, None].astype(float)])
    # A floor that rounding has broken by a hair must not make the programme infeasible.
    slack = np.where(open_, state.margins - now, np.maximum(state.margins - floor, 0.0))
    bounds = [(-radius, radius)] * 6 + [(None, None)]
    answer = linprog([0.0] * 6 + [-1.0], A_ub=rows, b_ub=slack, bounds=bounds, method="highs")
    if answer.x is None:
        return np.zeros(6), np.zeros(len(floor)), 0.0
    return answer.x[:6], np.where(open_, -answer.ineqlin.marginals, 0.0), float(answer.x[6])


def place_by_least_squares(
    points: Array,
    surfaces: Surfaces,
    *,
    rotation: Array | None = None,
    translation_mm: Array | None = None,
) -> tuple[Array, Array]:
    """Return part_R_survey and translation of the best fit: for comparison, not for milling."""
    pose = (
        np.eye(3) if rotation is None else rotation,
        np.zeros(3) if translation_mm is None else translation_mm,
    )
    for _ in range(ROUNDS):
        state = _State(points, surfaces, np.zeros(len(points)), pose)
        step = np.linalg.lstsq(state.jacobian, -state.margins, rcond=1e-9)[0]
        pose = state.moved(np.asarray(step, dtype=np.float64))
        if np.abs(step).max() < 1e-10:
            break
    return pose
