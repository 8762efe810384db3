"""./omm calibrate: camera.yaml with its covariance from a calibration set."""

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
    parser.add_argument("--out", metavar="CAMERA.yaml", type=Path, help="write the calibration")
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument("--report", metavar="PDF", type=Path, help="write it as a document")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate and print what came out."""
    from omm_core.errors import InputError

    if (arguments.set is None) == (arguments.foreign is None):
        raise InputError("Expected either a SET or --import FILE.")
    if arguments.foreign is not None:
        return _import(arguments)
    return _calibrate(arguments)


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
    print("\n".join(calibration_lines(result)))
    return 0
