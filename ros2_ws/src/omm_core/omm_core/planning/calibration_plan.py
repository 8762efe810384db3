"""Where to take the images of an in-machine calibration, and how well the camera is known then.

The plate is seen from three distances, with the spindle turned by quarters and beside its middle,
in patterns of growing size; the first pattern that gives what is wanted is the plan. What it gives
is predicted by the normal equations that the calibration itself would have (machine_run.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.camera_calibration.machine_run import plate_problem, plate_run
from omm_core.camera_calibration.model import PARAMETERS, Sensor, project_with_derivatives
from omm_core.camera_calibration.openness import camera_information, open_directions, sizes
from omm_core.camera_calibration.result import DISTANCES_MM, projection_sigma_px
from omm_core.errors import InputError
from omm_core.files.calibration_set import Touched
from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.imaging.lens import BrownPhotogrammetric
from omm_core.machine.kinematics import Kinematics
from omm_core.part_pose import Observation

Array = NDArray[np.float64]

SIGMA_PX = 0.02  # of a centre, as the detector has it on targets that are lit well
_HEIGHTS = (0.6, 1.0, 1.6)  # of the distance at which the plate fills the image
_ASIDE = 0.2  # of the image's width and height
_QUARTERS = tuple(np.radians((0.0, 90.0, 180.0, 270.0)))
# Distances, quarters of a turn and places beside the middle, smallest pattern first.
_SIDES = (((0, 0),), ((-1, -1), (1, 1)), ((-1, -1), (1, -1), (1, 1), (-1, 1)))
_PATTERNS = ((2, 1), (3, 1), (2, 2), (3, 2), (2, 3), (3, 3))
_EDGE = 0.03
_TURNED = 0.1
_PLACE = ("x_mm", "y_mm", "z_mm")  # what may stay open: it is assumed then


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationStop:
    """One image: axis positions (mm, rad), the spindle's pose, the targets that it shows."""

    axes: Mapping[str, float]
    machine_T_spindle: RigidTransform
    target_ids: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationPlan:
    """Stops, and what they give.

    ``projection_px`` is the worst sigma over the image at ``DISTANCES_MM``; ``sigma`` (13,) is NaN
    for the parameters in ``undetermined``; ``touch`` is the target to touch, None where none is.
    """

    stops: tuple[CalibrationStop, ...]
    sigma: Array
    projection_px: tuple[float, ...]
    undetermined: tuple[str, ...]
    reached: bool
    touch: int | None
    findings: tuple[str, ...]

    def to_json_dict(self) -> dict[str, Any]:
        """Return ``calibrate --plan --json``; null is what stays open."""
        return {
            "reached": self.reached,
            "stops": [
                {
                    "axes": dict(stop.axes),
                    "machine_T_spindle": {
                        "translation_mm": stop.machine_T_spindle.translation_mm.tolist(),
                        "quaternion_xyzw": np.asarray(
                            stop.machine_T_spindle.quaternion_xyzw()
                        ).tolist(),
                    },
                    "targets": list(stop.target_ids),
                }
                for stop in self.stops
            ],
            "parameters": list(PARAMETERS),
            "sigma": [float(s) if np.isfinite(s) else None for s in self.sigma],
            "undetermined": list(self.undetermined),
            "projection_px": {
                f"{d:.0f}_mm": p if np.isfinite(p) else None
                for d, p in zip(DISTANCES_MM, self.projection_px, strict=True)
            },
            "touch": self.touch,
            "findings": list(self.findings),
        }


def _quaternion(pose: RigidTransform) -> list[float]:
    return [float(v) for v in pose.quaternion_xyzw()]


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationScene:
    """What a plan is made for; ``touch`` is the sigma of a probed height, None where none is."""

    plate: Part
    machine_T_plate: RigidTransform
    camera: CameraCalibration
    kinematics: Kinematics
    stop_sigma_mm: float
    touch_sigma_mm: float | None

    def sensor(self) -> Sensor:
        """Return the sensor of the nominal camera."""
        lens = self.camera.lens
        if not isinstance(lens, BrownPhotogrammetric):
            raise InputError(
                "Expected a nominal camera of the model 'brown_photogrammetric', with which sets"
                " are calibrated."
            )
        return Sensor(
            name=self.camera.name,
            width_px=lens.width_px,
            height_px=lens.height_px,
            pixel_size_mm=lens.pixel_size_mm,
        )


def plan_calibration(scene: CalibrationScene, want_px: float) -> CalibrationPlan:
    """Return the smallest pattern that knows each point of the image at 300 mm to ``want_px``.

    Where none does, the largest one, with ``reached`` false.

    Raises
    ------
    InputError
        Where the machine reaches too few places above the plate.
    """
    turning = turning_axis(scene.kinematics)
    best: CalibrationPlan | None = None
    for heights, sides in _PATTERNS:
        stops, refused = _stops(scene, heights, sides, turning)
        if len(stops) < 3:
            continue
        best = _predicted(scene, stops, refused, turning)
        if best.projection_px[1] <= want_px:
            return best
    if best is None:
        raise InputError(
            "Expected places above the plate from which the camera sees it, the machine reaches"
            " fewer than three. Check where the plate lies, and the nominal camera's height."
        )
    return replace(best, reached=False)


def turning_axis(kinematics: Kinematics) -> str | None:
    """Return the axis that turns the spindle about its own axis and does nothing else."""
    zero = {axis.name: 0.0 for axis in kinematics.axes}
    start = kinematics.machine_T_spindle(zero)
    for axis in kinematics.axes:
        if not axis.rotary:
            continue
        moved = kinematics.machine_T_spindle({**zero, axis.name: _TURNED})
        same_axis = start.rotation[:, 2] @ moved.rotation[:, 2] > 1 - 1e-12
        shift = np.linalg.norm(moved.translation_mm - start.translation_mm)
        if same_axis and shift < 1e-9:
            return axis.name
    return None


def _stops(
    scene: CalibrationScene, heights: int, sides: int, turning: str | None
) -> tuple[list[CalibrationStop], int]:
    """Return the stops of a pattern that are within reach, and how many are not."""
    lens = scene.camera.lens
    f_px = focal_length_px(scene)
    xyz = np.array([t.xyz_mm for t in scene.plate.targets])
    extent = np.ptp(xyz, axis=0)[:2].max()
    full = float(extent) * f_px / min(lens.width_px, lens.height_px)
    places = _HEIGHTS if heights == 3 else (_HEIGHTS[0], _HEIGHTS[-1])
    focus = scene.camera.imaging.focus_mm
    stops, refused = [], 0
    for height in places:
        distance = full * height if focus is None else float(np.clip(full * height, *focus))
        for turn in _QUARTERS if turning else _QUARTERS[:1]:
            for side in _SIDES[sides - 1]:
                stop = _stop(scene, distance, turn, np.array(side, dtype=float), turning)
                if stop is None or len(stop.target_ids) < 3:
                    refused += 1
                else:
                    stops.append(stop)
    return stops, refused


def focal_length_px(scene: CalibrationScene) -> float:
    """Return the nominal focal length in pixels."""
    sensor = scene.sensor()
    return float(scene.camera.parameter_values(PARAMETERS[:1])[0]) / sensor.pixel_size_mm


def _stop(
    scene: CalibrationScene, distance: float, turn: float, side: Array, turning: str | None
) -> CalibrationStop | None:
    """Return the stop from which the plate's middle is seen so far, so turned, so far aside."""
    kinematics, taper = scene.kinematics, scene.camera.taper_T_camera
    rotary = dict.fromkeys(kinematics.rotary, 0.0)
    if turning:
        rotary[turning] = float(turn)
    linear = {axis.name: 0.0 for axis in kinematics.axes if not axis.rotary}
    rotation = kinematics.machine_T_spindle({**linear, **rotary}).rotation
    camera_R = rotation @ taper.rotation
    lens = scene.camera.lens
    aside = _ASIDE * distance / focal_length_px(scene) * side * [lens.width_px, lens.height_px]
    middle = scene.machine_T_plate @ np.mean([t.xyz_mm for t in scene.plate.targets], axis=0)
    camera_at = middle - camera_R @ np.array([*aside, distance])
    place = camera_at - rotation @ taper.translation_mm
    axes = kinematics.axes_at_tool_point(rotary, place, 0.0, turns_with_part=True)
    if kinematics.out_of_limits(axes):
        return None
    pose = kinematics.machine_T_spindle(axes)
    seen = tuple(t.id for t, pixel in zip(scene.plate.targets, _pixels(scene, pose), strict=True)
                 if np.isfinite(pixel).all())  # fmt: skip
    return CalibrationStop(axes=axes, machine_T_spindle=pose, target_ids=seen)


def _pixels(scene: CalibrationScene, pose: RigidTransform) -> Array:
    """Return where the targets appear, (T, 2); NaN outside of the image."""
    sensor, camera = scene.sensor(), scene.camera.parameter_values(PARAMETERS)
    points = np.array([scene.machine_T_plate @ t.xyz_mm for t in scene.plate.targets])
    in_taper = (points - pose.translation_mm) @ pose.rotation
    pixels = project_with_derivatives(sensor, camera, in_taper[:, None])[0]
    size = np.array([sensor.width_px, sensor.height_px])
    with np.errstate(invalid="ignore"):
        inside = (pixels > _EDGE * size) & (pixels < (1 - _EDGE) * size)
    return np.where(np.all(inside, axis=1, keepdims=True), pixels, np.nan)


def touched_target(scene: CalibrationScene, seen: set[int]) -> int:
    """Return the target to touch: of those seen, the one nearest to the plate's middle."""
    middle = np.mean([t.xyz_mm for t in scene.plate.targets], axis=0)
    targets = [t for t in scene.plate.targets if t.id in seen]
    return min(targets, key=lambda t: (float(np.linalg.norm(t.xyz_mm - middle)), t.id)).id


def _predicted(
    scene: CalibrationScene, stops: list[CalibrationStop], refused: int, turning: str | None
) -> CalibrationPlan:
    sensor, camera = scene.sensor(), scene.camera.parameter_values(PARAMETERS)
    seen = [
        Observation(
            stamp_ns=number,
            target_id=target.id,
            center_px=pixel,
            covariance_px2=SIGMA_PX**2 * np.eye(2),
            machine_T_spindle=stop.machine_T_spindle,
        )
        for number, stop in enumerate(stops)
        for target, pixel in zip(
            scene.plate.targets, _pixels(scene, stop.machine_T_spindle), strict=True
        )
        if np.isfinite(pixel).all()
    ]
    touched = None
    if scene.touch_sigma_mm is not None:
        touched = Touched(
            target=touched_target(scene, {o.target_id for o in seen}),
            z_mm=0.0,
            sigma_mm=scene.touch_sigma_mm,
        )
    run = plate_run(sensor, seen, scene.plate, scene.stop_sigma_mm, touched)
    plate = np.array(
        [*scene.machine_T_plate.euler_xyz_rad(), *scene.machine_T_plate.translation_mm]
    )
    values = {"camera": camera[None], "plate": plate[None]}
    problem = plate_problem(run, np.ones(len(seen), dtype=bool), values)
    information = camera_information(problem, {g.name: g.values for g in problem.groups})
    opened = open_directions(information, sizes(sensor, camera[0]))
    lost = {name for direction in opened for name in direction}
    kept = [i for i, name in enumerate(PARAMETERS) if name not in lost]
    covariance = np.zeros((13, 13))
    scale = 1.0 / np.sqrt(np.diag(information)[kept])
    inverse = np.linalg.inv(information[np.ix_(kept, kept)] * np.outer(scale, scale))
    covariance[np.ix_(kept, kept)] = inverse * np.outer(scale, scale)
    sigma = np.sqrt(np.diag(covariance))
    sigma[[i for i in range(13) if i not in kept]] = np.nan
    beyond = bool(lost - set(_PLACE))
    return CalibrationPlan(
        stops=tuple(stops),
        sigma=sigma,
        projection_px=tuple(
            float("inf")
            if beyond
            else float(projection_sigma_px(sensor, camera, covariance, d).max())
            for d in DISTANCES_MM
        ),
        undetermined=tuple(name for name in PARAMETERS if name in lost),
        reached=True,
        touch=None if touched is None else touched.target,
        findings=_findings(lost, refused, turning),
    )


def _findings(lost: set[str], refused: int, turning: str | None) -> tuple[str, ...]:
    told = []
    if turning is None:
        told.append(
            "no axis of the machine turns the spindle about its own axis: orient it by hand or by"
            " M19 for some of the images, or x_mm and y_mm of the camera stay open"
        )
    if lost - set(_PLACE):
        told.append(f"the pattern leaves open: {', '.join(sorted(lost))}; use a larger plate")
    if "z_mm" in lost:
        told.append("without a touched height z_mm of the camera stays open")
    if refused:
        told.append(f"{refused} places of the pattern are out of reach or show too few targets")
    return tuple(told)
