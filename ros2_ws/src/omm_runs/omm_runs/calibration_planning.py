"""Plans the images of an in-machine calibration from files, and writes them as a program."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from omm_core.errors import InputError
from omm_core.files.machine import load_machine
from omm_core.files.part import load_part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import load_calibration
from omm_core.machine.kinematics import Kinematics
from omm_core.planning.calibration_plan import (
    CalibrationPlan,
    CalibrationScene,
    plan_calibration,
)
from omm_core.planning.program import Program, ProgramStop, make_program
from omm_core.planning.touch import touch_at

_STOP_SIGMA_MM = 0.003  # where machine.yaml does not tell it
_FEWEST = 3  # targets that an image must show
_EXACTEST_MM, _COARSEST_MM = 1e-6, 1000.0  # of a touched height


@dataclass(frozen=True, kw_only=True)
class CalibrationPlanRequest:
    """What is given; ``plate_at_mm`` is the plate's origin in the machine."""

    plate_file: Path
    camera_file: Path
    machine_file: Path
    plate_at_mm: tuple[float, float, float]
    want_px: float
    touch_sigma_mm: float | None


def plan_from_files(request: CalibrationPlanRequest) -> tuple[CalibrationScene, CalibrationPlan]:
    """Return the plan and what it is for.

    Raises
    ------
    InputError
        Where a file cannot be used, or the machine does not reach the plate.
    """
    if not request.want_px > 0.0:
        raise InputError(f"Expected a wanted uncertainty above 0 px, got {request.want_px:g}.")
    touch = request.touch_sigma_mm
    if touch is not None and not _EXACTEST_MM <= touch <= _COARSEST_MM:
        raise InputError(
            f"Expected the sigma of a touched height between {_EXACTEST_MM:g} and"
            f" {_COARSEST_MM:g} mm, or 0 for none, got {touch:g}."
        )
    plate = load_part(request.plate_file)
    if len(plate.targets) < _FEWEST:
        raise InputError(
            f"{request.plate_file}: expected a plate of at least {_FEWEST} targets, got"
            f" {len(plate.targets)}."
        )
    declared = load_machine(request.machine_file).uncertainty.stop_sigma_mm
    scene = CalibrationScene(
        plate=plate,
        machine_T_plate=RigidTransform(
            rotation=np.eye(3), translation_mm=np.array(request.plate_at_mm)
        ),
        camera=load_calibration(request.camera_file),
        kinematics=Kinematics.load(request.machine_file),
        stop_sigma_mm=_STOP_SIGMA_MM if declared is None else max(declared, 1e-4),
        touch_sigma_mm=touch,
    )
    return scene, plan_calibration(scene, request.want_px)


def calibration_program(scene: CalibrationScene, plan: CalibrationPlan) -> Program:
    """Return the program that takes the images, and touches the target where the plan names one.

    ``touch`` is None where the machine cannot touch it from above (touch.py).
    """
    stops = [
        ProgramStop(axes=stop.axes, label=f"calibration {number} of {len(plan.stops)}")
        for number, stop in enumerate(plan.stops, start=1)
    ]
    program = make_program(scene.kinematics, stops, title="calibrate camera")
    if plan.touch is None or scene.touch_sigma_mm is None:
        return program
    places = {target.id: target.xyz_mm for target in scene.plate.targets}
    touch = touch_at(
        scene.kinematics,
        {name: plan.stops[-1].axes[name] for name in scene.kinematics.rotary},
        next(iter(program.away)),
        scene.machine_T_plate @ places[plan.touch],
        plan.touch,
        scene.touch_sigma_mm,
    )
    return replace(program, touch=touch)
