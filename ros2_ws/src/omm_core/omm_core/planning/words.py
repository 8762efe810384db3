"""What a person should know of a plan, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omm_core.planning.choosing import Pool
from omm_core.planning.prediction import determines
from omm_core.planning.program import tool_axis
from omm_core.planning.scene import AssumedNoise
from omm_core.planning.tour import beyond_the_part
from omm_core.planning.wish import Yardstick

if TYPE_CHECKING:
    from omm_core.planning.plan import Plan

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LITTLE = 0.12
"""Share of U that twice the images must take away to be worth their time."""


def findings_of(
    plan: Plan,
    pool: Pool,
    chosen: Indices,
    unseen: Mapping[int, str],
    once: Sequence[int],
    way_is_free: bool,
) -> tuple[str, ...]:
    """Return all findings of a plan; the reason why it does not reach the wish comes first."""
    words: list[str] = []
    if not plan.reached:
        words += _what_is_missing(plan, pool, chosen, unseen)
    words += [f"Target {target} cannot be seen: {why}." for target, why in unseen.items()]
    if once:
        words.append(f"Seen once only, from one place: {_list(once)}. A bump there goes unnoticed.")
    if not way_is_free:
        words.append(
            "Between two stops no way was found on which the camera keeps clear of the part's box:"
            " move the part, or allow the axes more travel."
        )
    words += _ends_of_the_way(plan)
    determined = determines(pool.designs, chosen)
    words += _more_images(pool, chosen) if determined else []
    words += _not_told(plan)
    words += _elsewhere(plan) if determined else _met(plan)
    return tuple(words)


def _what_is_missing(
    plan: Plan, pool: Pool, chosen: Indices, unseen: Mapping[int, str]
) -> list[str]:
    if not determines(pool.designs, chosen):
        return [
            "The pose is not determined: three targets that do not lie on a line are needed, seen"
            f" can be {len(plan.bumps_mm)} of {len(plan.scene.part.targets)}"
            + "".join(
                f"; {words}"
                for words in sorted({f"of the others, {why}" for why in unseen.values()})
            )
            + ". Put more where the camera can look at them."
        ]
    words = []
    score = pool.score(chosen)
    if plan.wish.of_pose and score > 1.0:
        words.append(
            f"The wanted U is not reached: the best plan, {len(plan.stops)} images, is"
            f" {score:.3g} times as large. {_what_helps(pool, chosen)}"
        )
    if plan.wish.bump_mm is not None:
        bad = {t: mm for t, mm in plan.bumps_mm.items() if not mm <= plan.wish.bump_mm}
        for target, mm in bad.items():
            told = f"only from {mm:.3f} mm" if np.isfinite(mm) else "not at all"
            words.append(
                f"A bump of target {target} would be noticed {told}, {plan.wish.bump_mm:g} mm is"
                " wanted: put more targets on the part, or measure them better."
            )
    return words


def _what_helps(pool: Pool, chosen: Indices) -> str:
    """Name the source whose removal would help most, and what to do about it."""
    scores = {source: _without(pool, chosen, source) for source in _HELP}
    best = min(scores, key=lambda source: scores[source])
    enough = "would reach it" if scores[best] <= 1.0 else "would not be enough alone"
    return (
        f"{_HELP[best]} {enough}: without their share U would be {scores[best]:.3g} times"
        " what is wanted."
    )


_HELP = {
    "image": "Larger targets or shorter distances",
    "stops": "More images, or a machine that repeats better,",
    "geometry": "A machine whose geometry errs less (compensated anew), or more targets,",
    "common": "More or better targets, and a better calibration,",
}


def _without(pool: Pool, chosen: Indices, source: str) -> float:
    if source == "common":
        designs = replace(pool.designs, common=pool.designs.common[..., :0])
        return replace(pool, designs=designs).score(chosen)
    return replace(pool, noise=pool.noise.without(source)).score(chosen)


def _ends_of_the_way(plan: Plan) -> list[str]:
    """Tell where an axis ends before the camera is beyond the part, at the program's ends."""
    kinematics = plan.scene.kinematics
    for stop in (plan.stops[0], plan.stops[-1]):
        name, outward = tool_axis(kinematics, stop.axes)
        axis = next(axis for axis in kinematics.axes if axis.name == name)
        end = outward * (axis.upper if outward > 0.0 else axis.lower)
        if end < outward * beyond_the_part(plan.scene, stop.axes, name):
            return [
                f"{name} ends before the camera is beyond the part's box: have the spindle beside"
                " the part before the program starts, and watch its first and last move."
            ]
    return []


def _more_images(pool: Pool, chosen: Indices) -> list[str]:
    """Say what twice the images would gain, from the same places."""
    U = [_worst_corner(pool.yardstick, pool, stops) for stops in (chosen, np.tile(chosen, 2))]
    gain = 1.0 - U[1] / U[0]
    if gain >= LITTLE:
        return [f"Twice the images would lower U by {gain:.0%}."]
    return [
        f"More images buy nothing (twice as many: {gain:.0%} of U). More or better targets do, or a"
        " machine whose geometry errs less."
    ]


def _worst_corner(yardstick: Yardstick, pool: Pool, stops: Indices) -> float:
    return float(yardstick.corner_U_mm(pool.covariances(stops[None])[0]).max())


def _not_told(plan: Plan) -> list[str]:
    words = []
    imaging, body = plan.scene.calibration.imaging, plan.scene.calibration.body
    if imaging.focus_mm is None:
        words.append(
            "camera.yaml tells no focus: distances are not limited by it (120 to 600 mm are tried)."
        )
    if imaging.max_tilt_rad is None:
        words.append("camera.yaml tells no max_tilt_rad: the tilt of targets is not limited by it.")
    if body is None:
        words.append(
            "camera.yaml tells no body: only the camera's own point is kept clear of the part."
        )
    if plan.scene.part.box_mm is None:
        words.append("part.yaml tells no box_mm: the part is taken to be the box of its targets.")
    exact = plan.scene.part.taken_as_exact()
    if exact:
        words.append(
            f"part.yaml tells no uncertainty of target {_list(exact)}: taken as exact, which U"
            " rests on."
        )
    if not plan.scene.calibration.parameters:
        words.append("camera.yaml tells no covariance: the calibration is taken as exact.")
    if plan.pace.assumed:
        words.append(
            f"Time is of a slow machine: machine.yaml does not tell {_list(plan.pace.assumed)}."
        )
    return words


def _elsewhere(plan: Plan) -> list[str]:
    return [*_lost(plan), *_met(plan)]


def _met(plan: Plan) -> list[str]:
    """Say where the camera would meet a part that lies elsewhere."""
    met = [place.words for place in plan.elsewhere if place.clearance_mm <= 0.0]
    if not met:
        return []
    return [
        f"Where the part lies elsewhere ({_list(met)}), the camera would meet its box: see that it"
        " lies within what is left of that, or have the program search (--search)."
    ]


def _lost(plan: Plan) -> list[str]:
    lost = [place for place in plan.elsewhere if place.seen < place.planned]
    if not lost:
        return ["All targets stay in view where the part lies 50 mm or 1° elsewhere."]
    worst = min(lost, key=lambda place: place.seen)
    blind = [place for place in lost if not np.isfinite(place.worst_corner_U_mm)]
    words = (
        f"Where the part lies elsewhere ({worst.words}), {worst.planned - worst.seen} of"
        f" {worst.planned} views are lost"
    )
    if blind:
        words += " and the pose is not determined"
    return [f"{words}: the program's correction is needed there (docs/planning.md)."]


def noise_words(noise: AssumedNoise) -> str:
    """Return the noise in words."""
    return (
        f"image {noise.image_sigma_px:g} px, stops {1e3 * noise.stop_sigma_mm:.3g} µm, geometry"
        f" {1e3 * noise.geometry_sigma_mm:.3g} µm over {noise.geometry_length_mm:.0f} mm"
    )


def _list(items: Sequence[object]) -> str:
    return ", ".join(str(item) for item in items)
