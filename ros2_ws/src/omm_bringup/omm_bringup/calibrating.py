"""What ``./omm calibrate`` does besides calibrating from a set: check, plan, import."""

from __future__ import annotations

import argparse
import json
from pathlib import Path


def check(arguments: argparse.Namespace) -> int:
    """Test an old calibration against a run."""
    from omm_core.errors import InputError
    from omm_report.check_text import check_lines
    from omm_runs.checking import check_run
    from omm_runs.solving import SolveRunOptions

    if arguments.out is not None or arguments.report is not None:
        raise InputError("--check writes no calibration and no document: use --json.")
    options = SolveRunOptions(
        part_file=arguments.part,
        calibration_file=arguments.calibration,
        machine_file=arguments.machine,
    )
    check = check_run(arguments.check, options).check
    write_json(arguments.json, check.to_json_dict())
    print("\n".join(check_lines(check)))
    return 0 if check.holds else 1


def import_foreign(arguments: argparse.Namespace) -> int:
    """Take the lens of another program's calibration."""
    from omm_core.errors import InputError
    from omm_core.files.camera_writing import write_camera
    from omm_runs.importing import import_calibration

    if arguments.report is not None:
        raise InputError("--report goes with a SET, not with --import.")
    text, told, lines = import_calibration(arguments.foreign)
    if arguments.out is not None:
        write_camera(arguments.out, text)
    write_json(arguments.json, told)
    print("\n".join(lines))
    return 0


def plan(arguments: argparse.Namespace) -> int:
    """Plan the images of an in-machine calibration, and write them as a program."""
    from omm_core.errors import InputError
    from omm_core.files.output import write_whole
    from omm_core.planning.other_programs import CONTROLS, program_text
    from omm_report.calibration_plan_text import calibration_plan_lines, program_lines
    from omm_runs.calibration_planning import (
        CalibrationPlanRequest,
        calibration_program,
        plan_from_files,
    )

    missing = [
        n for n in ("part", "calibration", "machine", "part_at") if not getattr(arguments, n)
    ]
    if missing:
        options = ", ".join(f"--{name.replace('_', '-')}" for name in missing)
        raise InputError(
            f"--plan needs {options}: the plate, a nominal camera, the machine, where."
        )
    if arguments.control not in CONTROLS:
        raise InputError(
            f"Expected one of the controls {', '.join(CONTROLS)}, got '{arguments.control}'."
        )
    scene, planned = plan_from_files(
        CalibrationPlanRequest(
            plate_file=arguments.part,
            camera_file=arguments.calibration,
            machine_file=arguments.machine,
            plate_at_mm=tuple(arguments.part_at),
            want_px=arguments.want,
            touch_sigma_mm=arguments.touch if arguments.touch != 0.0 else None,
        )
    )
    write_json(arguments.json, planned.to_json_dict())
    print("\n".join(calibration_plan_lines(scene, planned, arguments.want)))
    if arguments.out is not None and planned.reached:
        program = calibration_program(scene, planned)
        write_whole(arguments.out, program_text(program, arguments.control))
        print("\n".join(program_lines(program, planned, arguments.control)))
    return 0 if planned.reached else 1


def write_json(path: Path | None, content: object) -> None:
    """Write JSON whole, where a path is given."""
    from omm_core.files.output import write_whole

    if path is not None:
        write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")
