"""Stops among which a plan is chosen: each shows some target at some place of the image."""

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
from omm_core.planning.views import SMALLEST_DOT_PX, Views, focal_px, views

Array = NDArray[np.float64]

NEAREST_MM = 120.0
"""Nearest distance where camera.yaml tells no focus."""
_DISTANCES = 4
_GRID = (-1.0, -0.5, 0.0, 0.5, 1.0)  # places in the image, in shares of what holds the ring
_DECIMALS = 3  # of mm in a program
_STEP_RAD = np.deg2rad(30.0)  # between the positions of a rotary axis that are tried
_MOST_POSITIONS = 400  # of all rotary axes together
_MOST_ORIENTATIONS = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """Stops that are possible: reachable, free, with a target in view.

    Attributes
    ----------
    axes : tuple of mapping
        Positions by the control's names, mm and rad.
    spindles : tuple of RigidTransform
        machine_T_spindle at each.
    views : Views
    aimed_at : (C,) array of int
        Row of the target that each was made for.
    """

    axes: tuple[Mapping[str, float], ...]
    spindles: tuple[RigidTransform, ...]
    views: Views
    aimed_at: NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of stops."""
        return len(self.axes)


def find_candidates(
    scene: Scene, rotaries: Sequence[Mapping[str, float]]
) -> tuple[Candidates, dict[int, str]]:
    """Return all candidates with the rotary axes in given positions.

    Returns
    -------
    Candidates
    dict
        For each target (row) that no candidate sees: why not, in words.
    """
    axes: list[Mapping[str, float]] = []
    spindles: list[RigidTransform] = []
    aimed: list[int] = []
    why: dict[int, list[str]] = {row: [] for row in range(len(scene.part.targets))}
    for rotary in rotaries:
        rotation = _spindle_rotation(scene, rotary)
        for row in range(len(scene.part.targets)):
            for place in _places(scene, rotation, row):
                reached = _reach(scene, rotary, place)
                if isinstance(reached, str):
                    why[row].append(reached)
                    continue
                axes.append(reached)
                spindles.append(scene.kinematics.machine_T_spindle(reached))
                aimed.append(row)
    all_views = views(scene, spindles)
    good = _good(scene, spindles, all_views, np.array(aimed, dtype=np.int64), why)
    kept = np.flatnonzero(good)
    candidates = Candidates(
        axes=tuple(axes[i] for i in kept),
        spindles=tuple(spindles[i] for i in kept),
        views=all_views.only(kept),
        aimed_at=np.array(aimed, dtype=np.int64)[kept],
    )
    unseen = set(why) - set(np.flatnonzero(candidates.views.visible.any(axis=0)).tolist())
    return candidates, {row: _most_frequent(why[row]) for row in sorted(unseen)}


def rotary_positions(scene: Scene) -> list[dict[str, float]]:
    """Return positions of the rotary axes: all at zero (or nearest to it) first, then others.

    The others are those of a grid within the limits from which the spindle looks at most targets
    least slanted; each direction of the spindle once.
    """
    axes = [axis for axis in scene.kinematics.axes if axis.rotary]
    first = {a.name: float(np.clip(0.0, a.lower, a.upper)) for a in axes}
    if not axes:
        return [first]
    values = [_grid(axis.lower, axis.upper) for axis in axes]
    while np.prod([len(v) for v in values]) > _MOST_POSITIONS:
        longest = max(range(len(values)), key=lambda i: len(values[i]))
        values[longest] = values[longest][::2]
    normals = scene.normals_in_machine()
    ranked: list[tuple[float, dict[str, float]]] = []
    for combination in itertools.product(*values):
        rotary = dict(zip((a.name for a in axes), combination))
        slant = _slants(scene, rotary, normals)
        if np.any(slant > 0.0):
            turns = float(np.sum(np.abs(combination)))
            ranked.append((float(np.sum(slant)) - 0.05 * turns, rotary))
    ranked.sort(key=lambda item: -item[0])
    chosen, directions = [first], [_spindle_rotation(scene, first)]
    for _, rotary in _covering(scene, ranked, normals):
        rotation = _spindle_rotation(scene, rotary)
        if all(np.trace(rotation.T @ other) < 1 + 2 * np.cos(0.2) for other in directions):
            chosen.append(rotary)
            directions.append(rotation)
        if len(chosen) > _MOST_ORIENTATIONS:
            break
    return chosen


def _covering(
    scene: Scene, ranked: list[tuple[float, dict[str, float]]], normals: Array
) -> list[tuple[float, dict[str, float]]]:
    """Sort positions: first the best of each target, then by what they all contribute."""
    best: dict[int, tuple[float, dict[str, float]]] = {}
    for _, rotary in ranked:
        for row, slant in enumerate(_slants(scene, rotary, normals)):
            if slant > best.get(row, (0.0, {}))[0] + 1e-6:
                best[row] = (slant, rotary)
    first = sorted(best.values(), key=lambda item: -item[0])
    return [*first, *ranked]


def _slants(scene: Scene, rotary: Mapping[str, float], normals: Array) -> Array:
    """Return the cosine between normal and direction to the camera, 0 where it looks away, (T,)."""
    optical = _spindle_rotation(scene, rotary) @ scene.spindle_T_camera.rotation[:, 2]
    cosine = -np.nan_to_num(normals, nan=0.0) @ optical
    cosine = np.where(scene.outward(), cosine, np.abs(cosine))
    cosine = np.where(np.isnan(normals[:, 0]), 0.7, cosine)
    limit = scene.calibration.imaging.max_tilt_rad
    least = np.cos(min(np.deg2rad(60.0), limit if limit is not None else np.inf))
    return np.asarray(np.where(cosine > least, cosine, 0.0))


def _grid(lower: float, upper: float) -> Array:
    low, high = max(lower, -np.pi), min(upper, np.pi)
    steps = np.arange(np.ceil(low / _STEP_RAD), np.floor(high / _STEP_RAD) + 1) * _STEP_RAD
    ends = [v for v in (low, high) if abs(v) < np.pi - 1e-9]
    values = np.unique(np.round([*steps, *ends], 9))
    if high - low > 2 * np.pi - 1e-6:
        values = values[values > -np.pi + 1e-6]  # the same place as +π
    return values[np.argsort(np.abs(values), kind="stable")]


def _spindle_rotation(scene: Scene, rotary: Mapping[str, float]) -> Array:
    zero = {axis.name: 0.0 for axis in scene.kinematics.axes}
    return scene.kinematics.machine_T_spindle({**zero, **rotary}).rotation


def _places(scene: Scene, rotation: Array, row: int) -> Array:
    """Return places of the spindle from which a target lies at a grid of pixels, (P, 3)."""
    target = scene.targets_in_machine()[row]
    camera_in_spindle = scene.spindle_T_camera
    camera_R = rotation @ camera_in_spindle.rotation
    lens = scene.calibration.lens
    size = np.array([lens.width_px, lens.height_px], dtype=float)
    places = []
    for distance in _distances(scene, row):
        half = size / 2 - _ring_radius_px(scene, row, distance) - 8.0
        if np.any(half <= 0.0):
            continue
        pixels = np.array([(size - 1) / 2 + half * (u, v) for u in _GRID for v in _GRID])
        seen = lens.rays(pixels) * distance
        seen = seen[np.isfinite(seen).all(axis=1)]
        places.append(target - seen @ camera_R.T - rotation @ camera_in_spindle.translation_mm)
    return np.concatenate([np.zeros((0, 3)), *places])


def _distances(scene: Scene, row: int) -> Array:
    """Return distances along the optical axis to be tried, from near to far."""
    focal = focal_px(scene)
    target = scene.part.targets[row]
    farthest = 0.95 * focal * target.dot_diameter_mm / SMALLEST_DOT_PX
    ring_mm = scene.ring_ratio() * target.dot_diameter_mm + 2.0 * scene.play_mm
    smaller_side = min(scene.calibration.width_px, scene.calibration.height_px)
    nearest = max(NEAREST_MM, focal * ring_mm / (0.6 * smaller_side))
    focus = scene.calibration.imaging.focus_mm
    if focus is not None:
        margin = min(1.001 * scene.play_mm, 0.26 * (focus[1] - focus[0]))
        nearest, farthest = focus[0] + margin, min(focus[1] - margin, farthest)
    else:
        farthest = min(farthest, scene.farthest_mm)
    if nearest > farthest:
        return np.array([farthest])
    return np.geomspace(nearest, farthest, _DISTANCES if focus is not None else _DISTANCES + 1)


def _ring_radius_px(scene: Scene, row: int, distance_mm: float) -> float:
    diameter = scene.ring_ratio() * scene.part.targets[row].dot_diameter_mm
    diameter += 2.0 * scene.play_mm
    return 1.15 * 0.5 * diameter * focal_px(scene) / distance_mm


def _reach(scene: Scene, rotary: Mapping[str, float], place_mm: Array) -> Mapping[str, float] | str:
    """Return axis positions that bring the spindle to a place, rounded; or why not."""
    try:
        axes = scene.kinematics.axes_at_tool_point(rotary, place_mm, 0.0, turns_with_part=True)
    except InputError as error:
        return str(error)
    rounded = {
        axis.name: axes[axis.name] if axis.rotary else round(axes[axis.name], _DECIMALS) + 0.0
        for axis in scene.kinematics.axes
    }
    complaints = scene.kinematics.out_of_limits(rounded)
    return (
        f"axis {complaints[0].split(' = ')[0]} would be over its limit" if complaints else rounded
    )


def _good(scene: Scene, spindles, seen: Views, aimed, why) -> NDArray[np.bool_]:  # type: ignore[no-untyped-def]
    if not spindles:
        return np.zeros(0, dtype=bool)
    sees = seen.visible[np.arange(len(aimed)), aimed]
    free = clearance_mm(scene, spindles) >= CLEARANCE_MM
    for row, of_view, of_body in zip(aimed.tolist(), sees, free):
        if not of_view:
            why[row].append("it would be out of view, out of focus, too small or too slanted")
        elif not of_body:
            why[row].append("the camera would touch the part's box")
    return np.asarray(seen.visible.any(axis=1) & free)


def _most_frequent(reasons: list[str]) -> str:
    return max(sorted(set(reasons)), key=reasons.count, default="no distance suits it")
