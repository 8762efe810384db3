"""Where the ideal part lies in the raw one: the largest smallest margin, group by group.

Point p with outward normal n and foot q on its nominal face has the overstock
``a(T) = n · (T p - q) - thickness`` and the margin ``a - required``. For a small motion
x = (translation, rotation times size) about the centroid, a is linear, and the largest smallest
margin is a linear programme; steps are bounded by a trust region and taken where the margin as
recomputed from the surfaces grows. The multipliers of the last programme say which points
limit: the smallest margin is their weighted sum whatever the placement. Groups that limit keep
their margin, and the others are raised again; at last, of all placements that do as well, the
one is taken whose faces lie most parallel to their points.

Datum faces come first: by least squares, rank by rank, each in the freedom that those before
leave. Limits (a maximum, a tolerance between groups) hold throughout, as far as they can.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.overstock.placement_state import RANK, Placement, PlacementState, Pose, Surfaces
from omm_core.overstock.programme import Answer, nearest_allowed, raise_smallest
from omm_core.overstock.wish import Wish

Array = NDArray[np.float64]

SMALLEST_STEP_MM = 1e-10
ROUNDS = 60
MULTIPLIER = 1e-7
# A programme whose margin grows by this much, mm, has no end: nothing holds the part that way.
ENDLESS_MM = 1e5
FAR_MM = 1e7
BREACH = 100.0
# Of motions that change no spread, the least: small against a face of three points.
STAY = 1e-4
SLACK = 1e-10
PROMISED_MM = 1e-9
BOUNDED = 1e-7


def place_evenly(
    points: Array,
    surfaces: Surfaces,
    wish: Wish,
    *,
    thickness_mm: float = 0.0,
    rotation: Array | None = None,
    translation_mm: Array | None = None,
    rounds: int = ROUNDS,
    radius_mm: float | None = None,
) -> Placement:
    """Return the placement with the largest smallest margin, then group by group.

    Parameters
    ----------
    points : (N, 3) array
        Centres of the foils, survey frame, mm.
    surfaces : function
        Distance outside each point's face and its outward normal, from places in the part frame.
    wish : Wish
        Allowances and limits.
    thickness_mm : float
        Of the foil.
    rotation, translation_mm : (3, 3), (3,) arrays
        Start, part_T_survey.
    rounds, radius_mm : int, float
        Programmes a level, and the first bound of a step: few and small where the start is
        known to be close.
    """

    def state_at(pose: Pose) -> PlacementState:
        return PlacementState(points, surfaces, thickness_mm, wish, pose)

    state = state_at(
        (
            np.eye(3) if rotation is None else rotation,
            np.zeros(3) if translation_mm is None else translation_mm,
        )
    )
    state = _on_datum(state, state_at)
    floor = np.where(wish.is_aside, -np.inf, np.nan)
    done = wish.is_aside.copy()
    limiting, held = np.zeros(len(points)), np.zeros(len(state.limits))
    loose: list[Array] = []
    while not done.all():
        level = _raise_level(state, state_at, floor, done, rounds, radius_mm or 0.1 * state.size)
        state = level.state
        if not limiting.any():
            limiting, held = level.multipliers, level.held
        fixed = np.unique(wish.groups[~done & (level.multipliers > MULTIPLIER)])
        if level.endless is not None:
            loose.append(level.endless)
        if level.endless is not None or len(fixed) == 0:
            floor[~done] = _reached(level, floor, done)
            break
        now = ~done & np.isin(wish.groups, fixed)
        floor[now], done[now] = level.smallest, True
    state = _most_parallel(state, state_at, floor, wish)
    return _placement(state, limiting, held, loose)


def _on_datum(state: PlacementState, state_at: Callable[[Pose], PlacementState]) -> PlacementState:
    """Bring the datum faces to their stock."""
    for _ in range(ROUNDS):
        if np.abs(state.correction).max() < 1e-10:
            break
        state = state_at(state.moved(state.correction))
    return state


@dataclass(frozen=True, kw_only=True, eq=False)
class _Level:
    state: PlacementState
    multipliers: Array
    held: Array
    smallest: float
    endless: Array | None


def _reached(level: _Level, floor: Array, done: NDArray[np.bool_]) -> float:
    """Return the floor of what nothing stops.

    It is not raised without end, but keeps what all have by now.
    """
    highest = np.nanmax(np.append(floor[done & np.isfinite(floor)], level.smallest))
    return float(np.minimum(highest, level.state.margins[~done].min()))


def _raise_level(
    state: PlacementState,
    state_at: Callable[[Pose], PlacementState],
    floor: Array,
    done: NDArray[np.bool_],
    rounds: int,
    radius: float,
) -> _Level:
    """Raise the smallest margin of the groups that are not done; the others keep theirs."""
    multipliers, held = np.zeros(len(done)), np.zeros(len(state.limits))
    endless = None
    for _ in range(rounds):
        answer = _programme(state, floor, done, radius)
        if answer is None:
            break
        step, promised, multipliers, held, bounded = answer
        if not bounded:
            endless = _endless(state, floor, done)
            if endless is not None:
                break
        trial = state_at(state.moved(step))
        length = float(np.abs(step).max())
        gain = trial.margins[~done].min() - state.margins[~done].min()
        gain -= BREACH * (trial.breach(floor) - state.breach(floor))
        if gain >= 0.0:
            state = trial
            # Where the surfaces did as the programme promised, there is nothing left to gain.
            if length < 1e-9 or (bounded and abs(gain - promised) < PROMISED_MM):
                break
            radius *= 2.0
        else:
            radius = 0.25 * min(radius, length)
        if radius < SMALLEST_STEP_MM or (promised < 1e-12 and trial.breach(floor) < 1e-12):
            break
    return _Level(
        state=state,
        multipliers=multipliers,
        held=held,
        smallest=float(state.margins[~done].min()),
        endless=endless,
    )


def _programme(
    state: PlacementState, floor: Array, done: NDArray[np.bool_], radius: float
) -> tuple[Array, float, Array, Array, bool] | None:
    """Solve the linear programme.

    Returns step, promised gain, multipliers of points and of limits, and whether the rows alone
    bound the gain: then their weighted sum does not change with the motion.
    """
    rows = np.isfinite(state.margins) & ~np.isneginf(floor)
    values = np.where(done, state.margins - np.where(done, floor, 0.0), state.margins)[rows]
    values = np.concatenate([values, state.limits])
    jacobian = np.vstack([state.jacobian[rows], state.limit_rows])
    correction = np.clip(state.correction, -radius, radius)
    raised = np.concatenate([~done[rows], np.zeros(len(state.limits), dtype=bool)])
    values = values + jacobian @ correction
    answer = raise_smallest(values, jacobian @ state.freedom, raised, radius)
    if answer is None:
        return None
    multipliers = np.zeros(len(done))
    multipliers[rows] = answer.multipliers[: rows.sum()]
    multipliers[done] = 0.0
    now = float(state.margins[~done].min())
    step = correction + state.freedom @ _shortest(values, jacobian @ state.freedom, raised, answer)
    slope = float(np.abs(answer.multipliers @ (jacobian @ state.freedom)).max(initial=0.0))
    held = answer.multipliers[rows.sum() :]
    return step, answer.smallest_mm - now, multipliers, held, slope < BOUNDED


def _shortest(values: Array, jacobian: Array, raised: NDArray[np.bool_], answer: Answer) -> Array:
    """Return the shortest of the steps that answer a programme: nothing drifts without a reason.

    ``values`` and ``jacobian`` as given to the programme.
    """
    limit = np.where(raised, answer.smallest_mm, np.minimum(values + jacobian @ answer.step, 0.0))
    slack = SLACK * max(1.0, float(np.abs(answer.step).max(initial=0.0)))
    count = jacobian.shape[1]
    step = nearest_allowed(np.eye(count), np.zeros(count), jacobian, limit - values - slack)
    if step is None or not np.isfinite(step).all():
        return answer.step
    after = values + jacobian @ step - limit
    return answer.step if after.min() < -10.0 * slack else step


def _endless(state: PlacementState, floor: Array, done: NDArray[np.bool_]) -> Array | None:
    """Return the unit motion that raises all that is not done without end, or None."""
    answer = _programme(state, floor, done, FAR_MM)
    if answer is None or answer[1] < ENDLESS_MM:
        return None
    return np.asarray(answer[0] / np.linalg.norm(answer[0]))


def _most_parallel(
    state: PlacementState, state_at: Callable[[Pose], PlacementState], floor: Array, wish: Wish
) -> PlacementState:
    """Choose the placement with the least spread in each group, of those that keep all floors."""
    held = np.isfinite(floor)
    for _ in range(4):
        freedom = state.freedom
        if freedom.shape[1] == 0:
            break
        rows, wanted = _spread(state, wish, freedom)
        jacobian = np.vstack([state.jacobian[held], state.limit_rows]) @ freedom
        left = np.concatenate([(state.margins - floor)[held], state.limits])
        y = nearest_allowed(rows, wanted, jacobian, -np.maximum(left, 0.0))
        if y is None or not np.isfinite(y).all() or np.abs(y).max() > 0.1 * state.size:
            break
        trial = state_at(state.moved(freedom @ y))
        if trial.breach(floor) > state.breach(floor) + 1e-7:
            break
        state = trial
        if np.abs(y).max() < 1e-9:
            break
    return state


def _spread(state: PlacementState, wish: Wish, freedom: Array) -> tuple[Array, Array]:
    """Return rows and goal: each overstock minus its group's mean; a little of staying put."""
    sums = np.zeros((int(wish.groups.max()) + 1, 7))
    both = np.hstack([state.jacobian, state.overstock[:, None]])
    np.add.at(sums, wish.groups, both)
    counts = np.bincount(wish.groups, minlength=len(sums))
    apart = both - (sums / np.maximum(counts, 1)[:, None])[wish.groups]
    stay = STAY * np.eye(6)
    rows = np.vstack([apart[:, :6], stay]) @ freedom
    return rows, np.concatenate([-apart[:, 6], np.zeros(6)])


def _placement(
    state: PlacementState, limiting: Array, held: Array, loose: list[Array]
) -> Placement:
    values, axes = np.linalg.eigh(state.jacobian.T @ state.jacobian)
    return Placement(
        rotation=state.pose[0],
        translation_mm=state.pose[1],
        overstock_mm=state.overstock,
        margins_mm=state.margins,
        jacobian=state.jacobian,
        centre_mm=state.centre,
        size_mm=state.size,
        limiting=limiting,
        limits_held=held,
        breach_mm=float(max(-state.limits.min(initial=0.0), 0.0)),
        free=axes[:, values <= RANK**2 * values[-1]].T,
        loose=np.array(loose).reshape(-1, 6),
    )


def place_by_least_squares(
    points: Array,
    surfaces: Surfaces,
    *,
    rotation: Array | None = None,
    translation_mm: Array | None = None,
) -> Pose:
    """Return part_R_survey and translation of the best fit: for comparison, not for milling."""
    pose = (
        np.eye(3) if rotation is None else rotation,
        np.zeros(3) if translation_mm is None else translation_mm,
    )
    wish = Wish(groups=np.zeros(len(points), dtype=np.int64), required_mm=np.zeros(len(points)))
    for _ in range(ROUNDS):
        state = PlacementState(points, surfaces, 0.0, wish, pose)
        step = np.linalg.lstsq(state.jacobian, -state.overstock, rcond=1e-9)[0]
        pose = state.moved(np.asarray(step, dtype=np.float64))
        if np.abs(step).max() < 1e-10:
            break
    return pose
