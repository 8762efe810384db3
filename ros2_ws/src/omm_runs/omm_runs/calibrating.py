"""Calibrates a camera from a set: reads, finds dots, adjusts, writes camera.yaml."""

from __future__ import annotations

import datetime
import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from omm_core.camera_calibration.cmm import calibrate_by_places
from omm_core.camera_calibration.machine import calibrate_by_run
from omm_core.camera_calibration.model import PARAMETERS, Sensor
from omm_core.camera_calibration.result import CalibrationResult
from omm_core.errors import InputError
from omm_core.files.calibration_set import CmmSet, MachineSet, load_calibration_set
from omm_core.files.camera_writing import camera_yaml
from omm_core.files.part import load_part
from omm_core.imaging.calibration import load_calibration
from omm_runs.recorded_observations import observations_of_run


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


def _hint(nominal: Path | None) -> np.ndarray | None:
    if nominal is None:
        return None
    return load_calibration(nominal).parameter_values(PARAMETERS)


def _calibrate_cmm(given: CmmSet, sensor: Sensor) -> CalibrationResult:
    if given.pixels is None or given.sigma_px is None:
        raise InputError(f"{given.path}: expected the columns col_px and row_px; images later.")
    covariance = np.tile(given.sigma_px**2 * np.eye(2), (len(given.images), 1, 1))
    return calibrate_by_places(
        sensor,
        images=list(given.images),
        places=given.places_mm,
        pixels=given.pixels,
        covariance_px2=covariance,
        sigma_xyz_mm=given.sigma_xyz_mm,
        normal=given.normal,
        dot_diameter_mm=given.dot_diameter_mm,
        hint=_hint(given.nominal),
    )


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


def camera_file(given: CmmSet | MachineSet, result: CalibrationResult) -> str:
    """Return camera.yaml of a calibration."""
    sensor = result.sensor
    return camera_yaml(
        name=sensor.name,
        width_px=sensor.width_px,
        height_px=sensor.height_px,
        pixel_size_mm=sensor.pixel_size_mm,
        values=dict(zip(PARAMETERS, (float(v) for v in result.camera), strict=True)),
        covariance=result.covariance.tolist(),
        notes={
            "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
            "set_sha256": hashlib.sha256(given.path.read_bytes()).hexdigest(),
            "images": result.images,
            "sigma0": round(result.sigma0, 4),
            "rms_px": round(result.rms_px, 5),
            "distance_mm": [round(d, 1) for d in result.covered_mm],
            "undetermined": list(result.undetermined),
        },
    )
