"""./omm calibrate: camera.yaml with its covariance from a calibration set."""

import argparse
import json
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("set", metavar="SET", type=Path, help="a set.yaml or its folder")
    parser.add_argument("--out", metavar="CAMERA.yaml", type=Path, help="write the calibration")
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument("--report", metavar="PDF", type=Path, help="write it as a document")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate and print what came out."""
    from omm_core.files.camera_writing import write_camera
    from omm_core.files.output import write_whole
    from omm_report.calibration_text import calibration_lines
    from omm_runs.calibrating import calibrate_set, camera_file

    given, result = calibrate_set(arguments.set)
    if arguments.json is not None:
        content = json.dumps(result.to_json_dict(), indent=1, allow_nan=False)
        write_whole(arguments.json, content + "\n")
    if arguments.out is not None:
        write_camera(arguments.out, camera_file(given, result))
    if arguments.report is not None:
        from omm_report.calibration_report import calibration_document

        write_whole(arguments.report, calibration_document(result, given.path.parent.name))
    print("\n".join(calibration_lines(result)))
    return 0
