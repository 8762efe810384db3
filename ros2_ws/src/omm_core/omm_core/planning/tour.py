"""In which order the stops are gone to, and the way between them that stays clear of the part."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.geometry import RigidTransform
from omm_core.planning.collision import CLEARANCE_MM, clearance_mm
from omm_core.planning.scene import Scene
from omm_core.planning.timing import Pace

Array = NDArray[np.float64]

_STEP_MM = 20.0
_RETRACTS_MM = (50.0, 100.0, 200.0, 400.0, 800.0, 1600.0)
_TWO_OPT_PASSES = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Leg:
    """The way to one stop: axis positions between the one before and it, without both."""

    through: tuple[Mapping[str, float], ...]
    seconds: float
    free: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Tour:
    """Stops in their order; ``legs[i]`` leads from stop i to stop i + 1."""

    order: tuple[int, ...]
    legs: tuple[Leg, ...]
    seconds: float

    @property
    def free(self) -> bool:
        """Whether no leg comes near the part."""
        return all(leg.free for leg in self.legs)


def shortest_tour(scene: Scene, pace: Pace, axes: Sequence[Mapping[str, float]]) -> Tour:
    """Return the quickest order that was found: nearest next, then 2-opt."""
    count = len(axes)
    seconds = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            seconds[i, j] = seconds[j, i] = pace.move_s(axes[i], axes[j])
    order = min(
        (_two_opt(_nearest_next(seconds, start), seconds) for start in range(min(count, 12))),
        key=lambda o: _length(o, seconds),
        default=(),
    )
    legs = tuple(leg(scene, pace, axes[a], axes[b]) for a, b in itertools.pairwise(order))
    total = sum(part.seconds for part in legs) + pace.stop_s * count
    return Tour(order=tuple(order), legs=legs, seconds=total)


def leg(scene: Scene, pace: Pace, start: Mapping[str, float], end: Mapping[str, float]) -> Leg:
    """Return a way between two stops: straight where that is free, else back along the tool."""
    turning = [n for n in scene.kinematics.rotary if abs(start[n] - end[n]) > 1e-9]
    if not turning and _is_free(scene, [start, end]):
        return Leg(through=(), seconds=pace.move_s(start, end), free=True)
    best: tuple[Mapping[str, float], ...] = ()
    for retract in _RETRACTS_MM:
        through = _around(scene, start, end, retract)
        if through is None:
            continue
        best = through
        if _is_free(scene, [start, *through, end]):
            return Leg(through=through, seconds=_seconds(pace, start, through, end), free=True)
    return Leg(through=best, seconds=_seconds(pace, start, best, end), free=False)


def retracted(
    scene: Scene, axes: Mapping[str, float], distance_mm: float
) -> Mapping[str, float] | None:
    """Return axis positions with the spindle back along its own axis, None beyond a limit."""
    spindle = scene.kinematics.machine_T_spindle(axes)
    place = spindle.translation_mm + distance_mm * spindle.rotation[:, 2]
    rotary = {name: axes[name] for name in scene.kinematics.rotary}
    try:
        moved = scene.kinematics.axes_at_tool_point(rotary, place, 0.0, turns_with_part=True)
    except InputError:
        return None
    return None if scene.kinematics.out_of_limits(moved) else moved


def beyond_the_part(scene: Scene, axes: Mapping[str, float], name: str) -> float:
    """Return where a linear axis has the camera beyond the part's box, seen along the spindle.

    From there the other axes may go anywhere across without meeting the part.
    """
    spindle = scene.kinematics.machine_T_spindle(axes)
    moved = scene.kinematics.machine_T_spindle({**axes, name: axes[name] + 1.0})
    outward = spindle.rotation[:, 2]
    share = float((moved.translation_mm - spindle.translation_mm) @ outward)
    body = scene.calibration.body
    lowest = body.z_mm[0] if body is not None else scene.spindle_T_camera.translation_mm[2]
    box = scene.machine_T_part @ scene.part.box_corners()
    needed = float((box @ outward).max()) - float(lowest) + CLEARANCE_MM
    return float(axes[name] + (needed - spindle.translation_mm @ outward) / share)


def _around(
    scene: Scene, start: Mapping[str, float], end: Mapping[str, float], retract: float
) -> tuple[Mapping[str, float], ...] | None:
    out, over = retracted(scene, start, retract), retracted(scene, end, retract)
    if out is None or over is None:
        return None
    if all(abs(out[n] - over[n]) < 1e-9 for n in scene.kinematics.rotary):
        return (out, over)
    linear = {n: v for n, v in out.items() if n not in scene.kinematics.rotary}
    turned = {**linear, **{n: over[n] for n in scene.kinematics.rotary}}
    return (out, turned, over)


def _seconds(
    pace: Pace,
    start: Mapping[str, float],
    through: Sequence[Mapping[str, float]],
    end: Mapping[str, float],
) -> float:
    points = [start, *through, end]
    return sum(pace.move_s(a, b) for a, b in itertools.pairwise(points))


def _is_free(scene: Scene, points: Sequence[Mapping[str, float]]) -> bool:
    poses: list[RigidTransform] = []
    for a, b in itertools.pairwise(points):
        ends = [scene.kinematics.machine_T_spindle(p).translation_mm for p in (a, b)]
        turn = max((abs(a[n] - b[n]) for n in scene.kinematics.rotary), default=0.0)
        way = float(np.linalg.norm(ends[1] - ends[0])) + 300.0 * turn
        for share in np.linspace(0.0, 1.0, int(np.ceil(way / _STEP_MM)) + 1):
            between = {n: (1.0 - share) * a[n] + share * b[n] for n in a}
            poses.append(scene.kinematics.machine_T_spindle(between))
    return bool(np.all(clearance_mm(scene, poses) >= CLEARANCE_MM - 1e-6))


def _nearest_next(seconds: Array, start: int) -> list[int]:
    order, left = [start], set(range(len(seconds))) - {start}
    while left:
        here = order[-1]
        nearest = min(left, key=lambda j: (seconds[here, j], j))
        order.append(nearest)
        left.remove(nearest)
    return order


def _two_opt(order: list[int], seconds: Array) -> list[int]:
    for _ in range(_TWO_OPT_PASSES):
        better = False
        for i in range(len(order) - 1):
            for j in range(i + 1, len(order)):
                other = order[:i] + order[i : j + 1][::-1] + order[j + 1 :]
                if _length(other, seconds) < _length(order, seconds) - 1e-9:
                    order, better = other, True
        if not better:
            break
    return order


def _length(order: Sequence[int], seconds: Array) -> float:
    return float(sum(seconds[a, b] for a, b in itertools.pairwise(order)))
