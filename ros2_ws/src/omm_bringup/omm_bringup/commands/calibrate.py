"""./omm calibrate: make camera.yaml from a calibration set, or check whether an old one holds."""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("set", metavar="SET", type=Path, nargs="?", help="a set.yaml or its folder")
    parser.add_argument(
        "--import", dest="foreign", metavar="FILE", type=Path,
        help="take the lens of a calibration of ROS, OpenCV, Kalibr or Metashape",
    )  # fmt: skip
    parser.add_argument(
        "--check",
        metavar="RUN",
        type=Path,
        help="check whether a calibration still holds on a new run",
    )
    for name, words in (
        ("part", "part file"), ("calibration", "calibration"), ("machine", "machine.yaml"),
    ):  # fmt: skip
        parser.add_argument(
            f"--{name}", metavar="FILE", type=Path, help=f"{words} of --check, --plan"
        )
    parser.add_argument(
        "--plan", action="store_true", help="where to take images of a plate in the machine"
    )
    parser.add_argument(
        "--part-at", metavar=("X", "Y", "Z"), nargs=3, type=float, help="the plate, mm (--plan)"
    )
    parser.add_argument(
        "--want",
        metavar="PX",
        type=float,
        default=0.1,
        help="worst sigma over the image at 300 mm (--plan; default: %(default)s)",
    )
    parser.add_argument(
        "--touch",
        metavar="MM",
        type=float,
        default=0.005,
        help="sigma of the height that will be touched, 0: none (--plan; default: %(default)s)",
    )
    parser.add_argument("--control", default="linuxcnc", help="whose program --plan --out writes")
    parser.add_argument(
        "--out", metavar="FILE", type=Path, help="write camera.yaml, or the program"
    )
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument("--report", metavar="PDF", type=Path, help="write it as a document")
    parser.add_argument("--pictures", metavar="FOLDER", type=Path, help="write its pictures as PNG")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate, or do what an option asks for, and print what came out."""
    from omm_bringup.calibrating import check, import_foreign, plan
    from omm_core.errors import InputError

    tasks = {"set": _calibrate, "foreign": import_foreign, "check": check, "plan": plan}
    given = [name for name in tasks if getattr(arguments, name) not in (None, False)]
    if len(given) != 1:
        raise InputError("Expected one of SET, --import FILE, --check RUN and --plan.")
    of_others = [f"--{n}" for n in ("part", "calibration", "machine") if getattr(arguments, n)]
    if of_others and given[0] in ("set", "foreign"):
        raise InputError(f"{of_others[0]} goes with --check RUN or --plan.")
    if arguments.report is not None and given != ["set"]:
        raise InputError("--report goes with a SET.")
    if arguments.pictures is not None and given != ["set"]:
        raise InputError("--pictures goes with a SET.")
    return tasks[given[0]](arguments)


def _calibrate(arguments: argparse.Namespace) -> int:
    from omm_bringup.calibrating import write_json
    from omm_core.files.camera_writing import write_camera
    from omm_core.files.output import write_whole
    from omm_report.calibration_text import calibration_lines
    from omm_runs.calibrating import calibrate_set, camera_file

    given, result = calibrate_set(arguments.set)
    write_json(arguments.json, result.to_json_dict())
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
