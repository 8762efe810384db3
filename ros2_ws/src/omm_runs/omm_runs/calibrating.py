"""Calibrates a camera from a set: reads, finds dots, adjusts, writes camera.yaml."""

from __future__ import annotations

import datetime
import hashlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.camera_calibration.cmm import calibrate_by_places
from omm_core.camera_calibration.machine import calibrate_by_run
from omm_core.camera_calibration.model import PARAMETERS, Sensor, project_with_derivatives
from omm_core.camera_calibration.result import CalibrationResult
from omm_core.camera_calibration.single_dot import SingleDot
from omm_core.camera_calibration.which_dot import agreeing_things
from omm_core.errors import InputError
from omm_core.files.calibration_set import CmmSet, MachineSet, load_calibration_set
from omm_core.files.camera_writing import camera_yaml
from omm_core.files.part import load_part
from omm_core.files.sensor import NamedSensor
from omm_core.files.yaml_input import read_yaml
from omm_core.geometry import rotation_from_euler_xyz_rad
from omm_core.imaging.calibration import load_calibration
from omm_runs.dot_images import (
    dots_of_images,
    likely_dots,
    nearest_dots,
    without_what_stands_still,
)
from omm_runs.recorded_observations import observations_of_run

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# A dot farther than this from where a first calibration puts it is another thing.
_REACH_PX = 20.0
# A dot's diameter, measured in the images, is right within this: they are seen aslant.
_SIZE_ASTRAY = 0.25
# Fewer things that agree are a chance.
_FEWEST_AGREEING = 12
# Images that show one bright thing alone from which the first calibration is made without others.
_ENOUGH_ALONE = 30


def calibrate_set(path: Path) -> tuple[CmmSet | MachineSet, CalibrationResult]:
    """Calibrate from a set.yaml or the folder that holds it.

    Raises
    ------
    InputError
        If the set cannot be used.
    MeasurementError
        If it leaves the camera open.
    """
    given = load_calibration_set(path)
    sensor = Sensor(
        name=given.camera.name,
        width_px=given.camera.width_px,
        height_px=given.camera.height_px,
        pixel_size_mm=given.camera.pixel_size_mm,
    )
    if isinstance(given, MachineSet):
        return given, _calibrate_machine(given, sensor)
    return given, _calibrate_cmm(given, sensor)


def _hint(nominal: Path | None) -> Array | None:
    if nominal is None:
        return None
    return load_calibration(nominal).parameter_values(PARAMETERS)


def _calibrate_cmm(given: CmmSet, sensor: Sensor) -> CalibrationResult:
    if given.pixels is None or given.sigma_px is None:
        return _calibrate_images(given, sensor)
    _check_within(given, sensor)
    covariance = np.tile(given.sigma_px**2 * np.eye(2), (len(given.images), 1, 1))
    every = np.arange(len(given.images))
    return _by_places(given, sensor, every, given.pixels, covariance)


def _check_within(given: CmmSet, sensor: Sensor) -> None:
    """Raise InputError where a measured centre is not on the sensor."""
    size = np.array([sensor.width_px, sensor.height_px])
    assert given.pixels is not None
    outside = ((given.pixels < -0.5) | (given.pixels > size - 0.5)).any(axis=1)
    if outside.any():
        at = int(np.argmax(outside))
        col, row = given.pixels[at]
        raise InputError(
            f"{given.path}: expected centres within {sensor.width_px} x {sensor.height_px} pixels,"
            f" got ({col:.1f}, {row:.1f}) for {given.images[at]}. Check the camera's size."
        )


def _by_places(
    given: CmmSet, sensor: Sensor, which: Indices, pixels: Array, covariance: Array
) -> CalibrationResult:
    return calibrate_by_places(
        sensor,
        images=[given.images[i] for i in which],
        places=given.places_mm[which],
        pixels=pixels,
        covariance_px2=covariance,
        sigma_xyz_mm=given.sigma_xyz_mm,
        normal=given.target.normal,
        dot_diameter_mm=given.target.dot_diameter_mm,
        hint=_hint(given.nominal),
    )


def _calibrate_images(given: CmmSet, sensor: Sensor) -> CalibrationResult:
    """Calibrate by what is likely the dot; then by the dot that is where it must be."""
    shape = (sensor.height_px, sensor.width_px)
    dots = without_what_stands_still(dots_of_images(given.path.parent, given.images, shape))
    chosen = [of_image[0] if of_image else None for of_image in dots]
    if any(len(d) > 1 for d in dots):
        chosen = _that_agree(given, sensor, dots)
        chosen = _where_it_must_be(given, sensor, dots, _from_dots(given, sensor, chosen).camera)
    result = _from_dots(given, sensor, chosen)
    result = replace(result, findings=(*result.findings, *_other_size(given, result, chosen)))
    lost = [given.images[i] for i, dot in enumerate(chosen) if dot is None]
    if not lost:
        return result
    words = f"in {len(lost)} images no dot is found where it must be: {', '.join(lost[:5])}"
    return replace(result, findings=(*result.findings, words))


def _other_size(
    given: CmmSet, result: CalibrationResult, chosen: list[SingleDot | None]
) -> tuple[str, ...]:
    """Return a finding where the dot in the images is of another size than the set says."""
    optical = rotation_from_euler_xyz_rad(*result.camera[10:])[:, 2]
    depth = (given.places_mm - result.camera[7:10]) @ optical
    mm_per_px = depth * result.sensor.pixel_size_mm / result.camera[0]
    sizes = [s * dot.diameter_px for s, dot in zip(mm_per_px, chosen, strict=True) if dot]
    size, told = float(np.median(sizes)), given.target.dot_diameter_mm
    if abs(size / told - 1.0) < _SIZE_ASTRAY:
        return ()
    return (
        f"the dot is {size:.2f} mm wide in the images, and the set says {told:g} mm: its diameter,"
        " or the unit of the places, is wrong",
    )


def _from_dots(given: CmmSet, sensor: Sensor, chosen: list[SingleDot | None]) -> CalibrationResult:
    there = [(i, dot) for i, dot in enumerate(chosen) if dot is not None]
    return _by_places(
        given,
        sensor,
        np.array([i for i, _ in there], dtype=int),
        np.array([dot.center_px for _, dot in there]).reshape(-1, 2),
        np.array([dot.covariance_px2 for _, dot in there]).reshape(-1, 2, 2),
    )


def _that_agree(
    given: CmmSet, sensor: Sensor, dots: list[list[SingleDot]]
) -> list[SingleDot | None]:
    """Return of each image the thing that agrees with those of the others; else the largest."""
    which = agreeing_things(
        sensor,
        given.places_mm,
        [np.array([d.center_px for d in of_image]).reshape(-1, 2) for of_image in dots],
        [np.array([d.diameter_px for d in of_image]) for of_image in dots],
        given.target.dot_diameter_mm,
    )
    if sum(at is not None for at in which) < _FEWEST_AGREEING:
        return likely_dots(dots, _ENOUGH_ALONE)
    return [None if at is None else of_image[at] for at, of_image in zip(which, dots, strict=True)]


def _where_it_must_be(
    given: CmmSet, sensor: Sensor, dots: list[list[SingleDot]], camera: Array
) -> list[SingleDot | None]:
    predicted = project_with_derivatives(sensor, camera, given.places_mm[:, None])[0]
    return nearest_dots(dots, predicted, _REACH_PX)


def _calibrate_machine(given: MachineSet, sensor: Sensor) -> CalibrationResult:
    part = load_part(given.part)
    found = observations_of_run(given.run, part, (sensor.height_px, sensor.width_px))
    result = calibrate_by_run(
        sensor,
        found.observations,
        part,
        machine_sigma_mm=given.machine_sigma_mm,
        touched=given.touched,
        hint=_hint(given.nominal),
    )
    return replace(result, findings=(*result.findings, *found.refused))


def _carried_blocks(nominal: Path | None) -> dict[str, Any]:
    """Return what the hint tells of the camera and no calibration measures."""
    if nominal is None:
        return {}
    root = read_yaml(nominal, "calibration file")
    return {key: root.get(key) for key in ("imaging", "body") if key in root}


def camera_file(given: CmmSet | MachineSet, result: CalibrationResult) -> str:
    """Return camera.yaml of a calibration."""
    sensor = result.sensor
    return camera_yaml(
        sensor=NamedSensor(**asdict(sensor)),
        values=dict(zip(PARAMETERS, (float(v) for v in result.camera), strict=True)),
        covariance=result.covariance.tolist(),
        blocks=_carried_blocks(given.nominal),
        notes={
            "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
            "set_sha256": hashlib.sha256(given.path.read_bytes()).hexdigest(),
            "images": result.images,
            "sigma0": round(result.sigma0, 4),
            "rms_px": round(result.rms_px, 5),
            "distance_mm": [round(d, 1) for d in result.covered_mm],
            "image_px": [[round(v, 1) for v in corner] for corner in result.covered_px],
            "temperature_C": given.temperature_C,
            "undetermined": list(result.undetermined),
        },
    )
