"""./omm calibrate: make camera.yaml from a calibration set, or check whether an old one holds."""

import argparse
import json
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("set", metavar="SET", type=Path, nargs="?", help="a set.yaml or its folder")
    parser.add_argument(
        "--import", dest="foreign", metavar="FILE", type=Path,
        help="take the lens of a calibration of ROS, OpenCV, Kalibr or Metashape",
    )  # fmt: skip
    parser.add_argument(
        "--check", metavar="RUN", type=Path, help="does a calibration still hold on a new run?"
    )
    for name, words in (
        ("part", "part file"), ("calibration", "calibration"), ("machine", "machine.yaml"),
    ):  # fmt: skip
        parser.add_argument(
            f"--{name}", metavar="FILE", type=Path, help=f"{words} of --check (default: the run's)"
        )
    parser.add_argument("--out", metavar="CAMERA.yaml", type=Path, help="write the calibration")
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument("--report", metavar="PDF", type=Path, help="write it as a document")
    parser.add_argument("--pictures", metavar="FOLDER", type=Path, help="write its pictures as PNG")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate, or do what an option asks for, and print what came out."""
    from omm_core.errors import InputError

    tasks = {"set": _calibrate, "foreign": _import, "check": _check}
    given = [name for name in tasks if getattr(arguments, name) is not None]
    if len(given) != 1:
        raise InputError("Expected one of SET, --import FILE and --check RUN.")
    of_check = [f"--{n}" for n in ("part", "calibration", "machine") if getattr(arguments, n)]
    if of_check and given != ["check"]:
        raise InputError(f"{of_check[0]} goes with --check RUN.")
    if arguments.pictures is not None and given != ["set"]:
        raise InputError("--pictures goes with a SET.")
    return tasks[given[0]](arguments)


def _check(arguments: argparse.Namespace) -> int:
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
    _write_json(arguments.json, check.to_json_dict())
    print("\n".join(check_lines(check)))
    return 0 if check.holds else 1


def _import(arguments: argparse.Namespace) -> int:
    from omm_core.errors import InputError
    from omm_core.files.camera_writing import write_camera
    from omm_runs.importing import import_calibration

    if arguments.report is not None:
        raise InputError("--report goes with a SET, not with --import.")
    text, told, lines = import_calibration(arguments.foreign)
    if arguments.out is not None:
        write_camera(arguments.out, text)
    _write_json(arguments.json, told)
    print("\n".join(lines))
    return 0


def _write_json(path: Path | None, content: object) -> None:
    from omm_core.files.output import write_whole

    if path is not None:
        write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def _calibrate(arguments: argparse.Namespace) -> int:
    from omm_core.files.camera_writing import write_camera
    from omm_core.files.output import write_whole
    from omm_report.calibration_text import calibration_lines
    from omm_runs.calibrating import calibrate_set, camera_file

    given, result = calibrate_set(arguments.set)
    _write_json(arguments.json, result.to_json_dict())
    if arguments.out is not None:
        write_camera(arguments.out, camera_file(given, result))
    if arguments.report is not None:
        from omm_report.calibration_report import calibration_document

        write_whole(arguments.report, calibration_document(result, given.path.parent.name))
    if arguments.pictures is not None:
        from omm_report.calibration_figures import write_pictures

        write_pictures(result, arguments.pictures)
    print("\n".join(calibration_lines(result)))
    return 0
