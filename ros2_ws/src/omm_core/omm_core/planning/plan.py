"""A plan: stops, the uncertainty that they will give, the time that they take, and what to know."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import MeasurementError
from omm_core.files.machine import Machine
from omm_core.geometry import RigidTransform
from omm_core.planning.candidates import Candidates, find_candidates, rotary_positions
from omm_core.planning.choosing import TWICE, Pool, add_best, cover_twice, exchange, settle
from omm_core.planning.prediction import designs
from omm_core.planning.quickest import quickest
from omm_core.planning.scene import Scene
from omm_core.planning.sensitivity import Elsewhere, lies_elsewhere
from omm_core.planning.timing import Pace
from omm_core.planning.tour import Leg, shortest_tour
from omm_core.planning.wish import PlanWish, Yardstick, smallest_bumps_mm
from omm_core.planning.words import findings_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MOST_IMAGES_PER_TARGET = 6
# Play and farthest distance: what is given up first where targets cannot be seen otherwise.
_ROOM_MM = ((10.0, 600.0), (10.0, np.inf), (3.0, np.inf), (0.5, np.inf))
_GIVEN_UP = 0.1  # of U, for stops that lose targets less easily
_NO_GAIN = 0.02  # by one image more
_PATIENCE = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedStop:
    """One stop: axis positions by the control's names (mm, rad), and the targets in view."""

    axes: Mapping[str, float]
    machine_T_spindle: RigidTransform
    target_ids: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Stops in their order, and what they will give.

    Attributes
    ----------
    covariance : (7, 7) array
        Of θ in the machine's own coordinates, rad and mm.
    expanded_uncertainty : (7,) array
        k = 2.
    corner_U_mm : (8,) array
        Of the corners of the part's box.
    bumps_mm : mapping
        Smallest displacement that is noticed, by target number.
    legs : tuple of Leg
        ``legs[i]`` leads from stop i to stop i + 1.
    reached : bool
        Whether all that was wished is reached.
    """

    scene: Scene
    wish: PlanWish
    stops: tuple[PlannedStop, ...]
    covariance: Array
    expanded_uncertainty: Array
    corner_U_mm: Array
    bumps_mm: Mapping[int, float]
    seconds: float
    legs: tuple[Leg, ...]
    pace: Pace
    elsewhere: tuple[Elsewhere, ...]
    reached: bool
    findings: tuple[str, ...] = field(default=())

    def to_json(self) -> dict[str, Any]:
        """Return what ``plan --json`` holds (contract.md)."""
        return {
            "stops": [_stop_json(stop) for stop in self.stops],
            "predicted": {
                "covariance": self.covariance.tolist(),
                "expanded_uncertainty": self.expanded_uncertainty.tolist(),
                "worst_corner_U_mm": float(self.corner_U_mm.max()),
                "smallest_bump_mm": {
                    str(target): (mm if np.isfinite(mm) else None)
                    for target, mm in self.bumps_mm.items()
                },
            },
            "seconds": self.seconds,
            "part_taken_at": {
                "translation_mm": self.scene.machine_T_part.translation_mm.tolist(),
                "euler_xyz_rad": list(self.scene.machine_T_part.euler_xyz_rad()),
            },
            "reached": self.reached,
            "elsewhere": [place.to_json() for place in self.elsewhere],
            "findings": list(self.findings),
        }


def _stop_json(stop: PlannedStop) -> dict[str, Any]:
    return {
        "axes": {name: float(value) for name, value in stop.axes.items()},
        "machine_T_spindle": {
            "translation_mm": stop.machine_T_spindle.translation_mm.tolist(),
            "quaternion_xyzw": stop.machine_T_spindle.quaternion_xyzw().tolist(),
        },
        "targets": list(stop.target_ids),
    }


def make_plan(
    scene: Scene, machine: Machine, wish: PlanWish, *, told: tuple[str, ...] = ()
) -> Plan:
    """Return the plan that reaches a wish, or the best that there is.

    With the fewest images; with ``wish.least_time`` in the least time.

    Parameters
    ----------
    told : tuple of str
        What is known already and belongs to the findings.

    Raises
    ------
    MeasurementError
        Where no target can be seen from anywhere.
    """
    planned_play, found = scene.play_mm, None
    for play_mm, farthest_mm in _ROOM_MM:
        closer = replace(scene, play_mm=min(play_mm, planned_play), farthest_mm=farthest_mm)
        searched = _searched(closer, wish)
        # Less room is worth it only where it shows more targets.
        if found is None or len(searched[1]) < len(found[1][1]):
            found = (closer, searched)
        if not found[1][1]:
            break
    assert found is not None  # there is room to be tried
    scene, (candidates, unseen, pool, chosen) = found
    if scene.play_mm < planned_play:
        told = (*told, f"Where a target lies more than {scene.play_mm:g} mm from where it is"
                " thought to be, it may be out of view or out of focus.")  # fmt: skip
    if pool is None:
        why = "; ".join(sorted(set(unseen.values()))) or "there is none"
        raise MeasurementError(
            f"No target of {scene.part.name} can be seen from anywhere on {scene.kinematics.name}:"
            f" {why}. Is the part where the plan thinks it is?"
        )
    pace = Pace.of(machine, scene.kinematics, scene.calibration.imaging.exposure_s or 0.0)
    if wish.least_time:
        chosen = quickest(scene, pace, candidates, pool, chosen)
    return _finished(scene, pace, wish, candidates, pool, chosen, unseen, told)


def _searched(
    scene: Scene, wish: PlanWish
) -> tuple[Candidates, dict[int, str], Pool | None, Indices]:
    """Return candidates, what they do not see, and the choice; turned only where that is needed."""
    rotaries = rotary_positions(scene)
    candidates, unseen = find_candidates(scene, rotaries[:1])
    pool, chosen = _choose(scene, candidates, wish)
    if len(rotaries) > 1 and (unseen or not _reached(pool, chosen)):
        candidates, unseen = find_candidates(scene, rotaries)
        pool, chosen = _choose(scene, candidates, wish)
    return candidates, unseen, pool, chosen


def _choose(scene: Scene, candidates: Candidates, wish: PlanWish) -> tuple[Pool | None, Indices]:
    """Return the stops: all seen twice, exchanged, and more as long as that is needed and helps."""
    if not len(candidates):
        return None, np.zeros(0, dtype=np.int64)
    pool = Pool(
        designs=designs(scene, candidates.spindles, candidates.views),
        visible=candidates.views.visible,
        margin_mm=candidates.views.margin_mm,
        noise=scene.noise,
        yardstick=Yardstick.of(scene, wish),
    )
    chosen = exchange(pool, cover_twice(pool))
    best, wait = chosen, 0
    most = MOST_IMAGES_PER_TARGET * len(scene.part.targets)
    while not _reached(pool, best) and len(chosen) < most and wait < _PATIENCE:
        chosen = exchange(pool, add_best(pool, chosen), passes=2)
        helps = pool.shortfall(chosen) < (1.0 - _NO_GAIN) * pool.shortfall(best)
        best, wait = (chosen, 0) if helps else (best, wait + 1)
    return pool, _settled(pool, best, wish)


def _settled(pool: Pool, chosen: Indices, wish: PlanWish) -> Indices:
    """Return stops that lose targets less easily, for a little of U; the wish stays reached."""
    best = pool.score(chosen)
    limit = best * (1.0 + _GIVEN_UP)
    if wish.of_pose and best <= 1.0:
        limit = min(limit, 1.0)
    settled = settle(pool, chosen, limit)
    keeps = pool.shortfall(settled) <= max(1.0, pool.shortfall(chosen))
    return settled if keeps else chosen


def _reached(pool: Pool | None, chosen: Indices) -> bool:
    return pool is not None and pool.shortfall(chosen) <= 1.0


def _finished(scene, pace, wish, candidates, pool, chosen, unseen, told) -> Plan:  # type: ignore[no-untyped-def]
    tour = shortest_tour(scene, pace, [candidates.axes[i] for i in chosen])
    ordered = chosen[list(tour.order)]
    covariance = pool.covariances(ordered[None])[0]
    yardstick = pool.yardstick
    bumps = smallest_bumps_mm(pool.designs, scene.noise, ordered)
    ids = [target.id for target in scene.part.targets]
    stops = tuple(
        PlannedStop(
            axes=candidates.axes[i],
            machine_T_spindle=candidates.spindles[i],
            target_ids=tuple(ids[t] for t in np.flatnonzero(candidates.views.visible[i])),
        )
        for i in ordered
    )
    reached = _reached(pool, ordered) and tour.free
    plan = Plan(
        scene=scene,
        wish=wish,
        stops=stops,
        covariance=yardstick.theta_covariance(covariance),
        expanded_uncertainty=yardstick.expanded(covariance),
        corner_U_mm=yardstick.corner_U_mm(covariance),
        bumps_mm={ids[row]: mm for row, mm in bumps.items()},
        seconds=tour.seconds,
        legs=tour.legs,
        pace=pace,
        elsewhere=lies_elsewhere(scene, yardstick, [s.machine_T_spindle for s in stops]),
        reached=reached,
    )
    times = pool.visible[ordered].sum(axis=0)
    once = [ids[row] for row in np.flatnonzero((times > 0) & (times < TWICE))]
    words = findings_of(
        plan, pool, ordered, {ids[row]: why for row, why in unseen.items()}, once, tour.free
    )
    return replace(plan, findings=(*words, *told))
