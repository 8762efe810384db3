"""Leads a measuring program to a part that lies elsewhere: the next stop from what was seen so far.

Before the pose is determined, something is known of it already: one dot tells a direction by its
centre and a distance by its size, and the part is not anywhere. So the pose is estimated with a
prior about the planned place, as wide as parts are laid wrong (least squares of pixels, of the
logarithms of diameters, and of the prior). Where nothing is seen the place is searched around,
nearest first; one step back along the spindle shows more and comes early.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.geometry import RigidTransform
from omm_core.part_pose.kernels import rotate
from omm_core.planning.prediction import local_state
from omm_core.planning.scene import Scene
from omm_core.planning.sightings import PredictedSighting, predicted_sightings
from omm_core.planning.views import focal_px

Array = NDArray[np.float64]

AS_PLANNED, CORRECTED, NOTHING_SEEN = 0, 1, 2
_PRIOR_SIGMA = np.array([0.02, 0.02, 0.02, 120.0, 120.0, 120.0, 0.003])
_PIXEL_SIGMA = 0.5
_DIAMETER_SIGMA = 0.01  # relative
_SMALLEST_MM = 0.5  # corrections below are none
_STEPS = np.array([1e-5, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2, 1e-5])
_ITERATIONS = 30
_OVERLAP = 0.9
_SURE = 0.85  # of a planned stop's distance: what is known of it then
_NEXT_LAYER = 1000.0  # more than any way across
_MOST_PLACES = 40  # where a planned stop's targets are searched


@dataclass(frozen=True, kw_only=True, eq=False)
class GuidedStop:
    """A stop of the program: planned axes, the rows of the targets that it is for."""

    axes: Mapping[str, float]
    rows: tuple[int, ...]
    look_mm: float = 0.0
    """How far back from a planned stop this one looks at the part; 0 for a planned stop."""


@dataclass(frozen=True, kw_only=True)
class StopCorrection:
    """What the program is told: a shift of X, Y, Z (mm), and what it is of.

    ``status`` is AS_PLANNED or CORRECTED: the shift is the next stop's; NOTHING_SEEN: the same
    stop is to be tried again, shifted so.
    """

    status: int
    shift_mm: tuple[float, float, float]


@dataclass(kw_only=True, eq=False)
class Guide:
    """State of one measuring program.

    Parameters
    ----------
    scene : Scene
        With the part where the plan took it to be.
    stops : sequence of GuidedStop
        In the order of the program's images.
    limit_mm : float
        Larger shifts are not asked for: the program would clamp them.
    """

    scene: Scene
    stops: Sequence[GuidedStop]
    limit_mm: float
    _seen: list[PredictedSighting] = field(default_factory=list)
    _tries: dict[int, int] = field(default_factory=dict)
    _x: Array = field(default_factory=lambda: np.zeros(7))
    """(ω, d_0, γ_s) from the planned place: what is believed now."""

    def __post_init__(self) -> None:
        if not self.stops:
            raise InputError("Expected a plan with stops to lead a program, got none.")
        names = {axis.name for axis in self.scene.kinematics.axes}
        if not set("XYZ") <= names:
            raise InputError(f"Expected axes X, Y, Z to lead a program, got {', '.join(names)}.")

    def reset(self) -> None:
        """Forget everything: another program begins."""
        self._seen, self._tries, self._x = [], {}, np.zeros(7)

    @property
    def machine_T_part(self) -> RigidTransform:
        """Where the part is, as far as is known."""
        return self._moved_by(self._x)

    def after_image(
        self,
        number: int,
        machine_T_spindle: RigidTransform,
        found: Mapping[int, tuple[Array, float]],
    ) -> StopCorrection:
        """Take in what image ``number`` (from 1) showed; return what the program is to be told.

        Parameters
        ----------
        found : mapping
            By target number: centre (2,) px and diameter px. Others than the part's are ignored.
        """
        rows = {target.id: row for row, target in enumerate(self.scene.part.targets)}
        new = [
            PredictedSighting(
                machine_T_spindle=machine_T_spindle,
                row=rows[target],
                center_px=np.asarray(center, dtype=float),
                diameter_px=float(diameter),
            )
            for target, (center, diameter) in found.items()
            if target in rows
        ]
        self._seen += new
        if new:
            self._x = self._estimated()
        present = min(number, len(self.stops)) - 1
        wanted = set(self.stops[present].rows)
        if wanted & {sighting.row for sighting in new}:
            following = min(present + 1, len(self.stops) - 1)
            shift = self._shift(following)
            small = np.abs(shift).max() < _SMALLEST_MM
            return _correction(AS_PLANNED if small else CORRECTED, shift)
        place = 0 if new else self._tries.get(number, 0) + 1
        self._tries[number] = place
        pattern = self.search_pattern(present)
        if place < len(pattern) or self.stops[present].look_mm:
            shift = self._shift(present, pattern[place % len(pattern)])
            return _correction(NOTHING_SEEN, shift)
        # This stop's targets are not to be found: the others may still be.
        return _correction(CORRECTED, self._shift(min(present + 1, len(self.stops) - 1)))

    def _shift(self, stop: int, aside_mm: Array | None = None) -> Array:
        """Return the shift of a stop's X, Y, Z that shows its targets where they were planned."""
        planned = self.stops[stop]
        rows = list(planned.rows)
        before = self.scene.targets_in_machine()[rows]
        now = self.scene.elsewhere(self.machine_T_part).targets_in_machine()[rows]
        moved = (now - before).mean(axis=0)
        if aside_mm is not None:
            moved = moved + aside_mm
        kinematics = self.scene.kinematics
        rotary = {name: planned.axes[name] for name in kinematics.rotary}
        place = kinematics.machine_T_spindle(planned.axes).translation_mm + moved
        axes = kinematics.axes_at_tool_point(rotary, place, 0.0, turns_with_part=True)
        limits = {axis.name: (axis.lower, axis.upper) for axis in kinematics.axes}
        shift = [float(np.clip(axes[n], *limits[n])) - planned.axes[n] for n in "XYZ"]
        # A look from afar is that much farther from where the part may be at the other end.
        limit = self.limit_mm + planned.look_mm
        return np.clip(shift, -limit, limit)

    def search_pattern(self, stop: int) -> Array:
        """Return shifts in the machine, (P, 3) mm, in their order, as far as the limit goes.

        Across, the nearest first. Along the spindle: back before in, because what is not seen from
        farther back does not lie nearer, so that going in meets nothing. At a look from afar, layer
        by layer inwards; there everything is searched, elsewhere the first places only.
        """
        spindle = self.scene.kinematics.machine_T_spindle(self.stops[stop].axes)
        camera_R = (spindle @ self.scene.spindle_T_camera).rotation
        distance = self._distance_mm(stop, spindle)
        ring = max(t.dot_diameter_mm for t in self.scene.part.targets) * self.scene.ring_ratio()
        size = np.array([self.scene.calibration.width_px, self.scene.calibration.height_px])
        places: list[tuple[float, Array]] = []
        for back, cost, nearest in self._layers(stop, distance):
            seen = size / focal_px(self.scene) * nearest
            step = np.maximum(_OVERLAP * (seen - 1.1 * ring), ring)
            counts = np.ceil(self.limit_mm / step).astype(int)
            for i in range(-counts[0], counts[0] + 1):
                for j in range(-counts[1], counts[1] + 1):
                    aside = camera_R[:, :2] @ (np.array([i, j]) * step)
                    shift = aside + back * spindle.rotation[:, 2]
                    places.append((float(np.hypot(i, j)) + cost, shift))
        places.sort(key=lambda item: item[0])
        most = len(places) if self.stops[stop].look_mm else _MOST_PLACES
        return np.array([shift for _, shift in places[:most]]).reshape(-1, 3)

    def _layers(self, stop: int, distance: float) -> list[tuple[float, float, float]]:
        """Return how far back (mm) to look from, its cost in places across, and the nearest (mm).

        The last is the nearest distance at which targets are looked for there: what is nearer was
        seen from the places before.
        """
        focus, look_mm = self.scene.calibration.imaging.focus_mm, self.stops[stop].look_mm
        if focus is None:
            nearest = distance - look_mm if look_mm else _SURE * distance
            back = min(0.5 * distance, self.limit_mm)
            return [(0.0, 0.0, nearest), (back, 0.9, nearest + back)]
        near, far = focus
        spacing = 0.8 * (far - near)
        if look_mm:  # inwards from where it begins, until the part may not be farther away
            first = float(np.clip(distance - look_mm, near, far))
            count = int(np.ceil((look_mm + self.limit_mm) / spacing))
            inner = [(-k * spacing, _NEXT_LAYER * k, far - spacing) for k in range(1, count + 1)]
            return [(0.0, 0.0, first), *inner]
        count = int(self.limit_mm // spacing)
        back_off = [(k * spacing, 1.2 * k, max(near, _SURE * distance)) for k in range(count + 1)]
        inner = [(-k * spacing, _NEXT_LAYER * k, far - spacing) for k in range(1, count + 1)]
        return [*back_off, *inner]

    def _distance_mm(self, stop: int, spindle: RigidTransform) -> float:
        camera = spindle @ self.scene.spindle_T_camera
        targets = self.scene.targets_in_machine()[list(self.stops[stop].rows)]
        depth = (targets - camera.translation_mm) @ camera.rotation[:, 2]
        return float(max(depth.mean(), 1.0))

    def _estimated(self) -> Array:
        """Return (ω, d_0, γ_s) from all sightings and the prior (Gauss-Newton, damped).

        It starts where the part was believed to be: from farther there are other valleys.
        """
        x = self._x
        cost, residuals = self._residuals(x)
        damping = 1e-6
        for _ in range(_ITERATIONS):
            steps = [(self._residuals(x + step)[1] - residuals) for step in np.diag(_STEPS)]
            J = np.column_stack(steps) / _STEPS
            normal = J.T @ J
            normal[range(7), range(7)] *= 1.0 + damping
            change = -np.linalg.solve(normal, J.T @ residuals)
            new_cost, new_residuals = self._residuals(x + change)
            if new_cost < cost:
                done = cost - new_cost < 1e-6 * cost + 1e-9
                x, cost, residuals, damping = x + change, new_cost, new_residuals, damping * 0.1
                if done:
                    break
            else:
                damping = max(damping * 20.0, 1e-4)
                if damping > 1e8:
                    break
        return x

    def _moved_by(self, x: Array) -> RigidTransform:
        state, X0 = local_state(self.scene)
        rotation = np.empty((3, 3))
        rotate(state.rotation, x[0], x[1], x[2], rotation)
        return RigidTransform(
            rotation=rotation, translation_mm=state.d0_mm + x[3:6] - rotation @ X0
        )

    def _residuals(self, x: Array) -> tuple[float, Array]:
        moved = self.scene.elsewhere(self._moved_by(x))
        pixels, diameters = predicted_sightings(moved, self.scene.gamma_s_rad + x[6], self._seen)
        measured = np.array([sighting.center_px for sighting in self._seen])
        sizes = np.array([sighting.diameter_px for sighting in self._seen])
        residuals = np.concatenate(
            [
                ((pixels - measured) / _PIXEL_SIGMA).ravel(),
                np.log(diameters / sizes) / _DIAMETER_SIGMA,
                x / _PRIOR_SIGMA,
            ]
        )
        # Where a target would be behind the camera: far worse than any other place.
        residuals = np.where(np.isfinite(residuals), residuals, 1e6)
        return float(residuals @ residuals), residuals


def _correction(status: int, shift: Array) -> StopCorrection:
    x, y, z = (round(float(v), 4) for v in shift)
    return StopCorrection(status=status, shift_mm=(x, y, z))
