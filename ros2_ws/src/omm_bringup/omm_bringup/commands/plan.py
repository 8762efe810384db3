"""./omm plan: where to take images for a wanted uncertainty, as a program."""

import argparse
import json
import re
from pathlib import Path

_NEGATIVE = re.compile(r"^-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?(,.*)?$")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser._negative_number_matcher = _NEGATIVE  # argparse knows no exponents
    parser.add_argument("--part", type=Path, required=True, metavar="PART.yaml")
    parser.add_argument("--calibration", type=Path, required=True, metavar="CAMERA.yaml")
    parser.add_argument("--machine", type=Path, required=True, help="machine.yaml or URDF")
    parser.add_argument(
        "--part-at", type=float, nargs=3, metavar=("X", "Y", "Z"),
        help="about where the part's origin is, mm (default: the part's nominal)",
    )  # fmt: skip
    parser.add_argument(
        "--part-turned", type=float, nargs=3, metavar=("A", "B", "G"),
        help="and how it is turned about fixed x, y, z, rad",
    )  # fmt: skip
    parser.add_argument("--near", type=Path, metavar="RUN", help="where a run found the part")
    parser.add_argument(
        "--want", type=_two, metavar="MM,MM_PER_M", help="U of places, and of angles (mm/m)"
    )
    parser.add_argument("--want-point", type=float, metavar="MM", help="U of the worst corner")
    parser.add_argument("--bump", type=float, metavar="MM", help="displaced targets to be noticed")
    parser.add_argument("--out", type=Path, metavar="PROGRAM.ngc", help="the measuring program")
    parser.add_argument(
        "--control",
        default="linuxcnc",
        help="or siemens, heidenhain, fanuc, fagor (templates)",
    )
    parser.add_argument(
        "--limit",
        type=float,
        default=50.0,
        metavar="MM",
        help="largest correction of a stop (%(default)g)",
    )
    parser.add_argument(
        "--search", type=float, metavar="MM",
        help="the part may lie that far off: begin from afar, look around, correct by so much",
    )  # fmt: skip
    parser.add_argument("--picture", type=Path, metavar="PNG", help="part and stops")
    parser.add_argument("--report", type=Path, metavar="PDF")
    parser.add_argument("--json", type=Path, metavar="OUT")


def run(args: argparse.Namespace) -> int:
    """Plan, print, and write what was asked for; 1 where the wish cannot be reached."""
    from omm_core.errors import InputError, MeasurementError
    from omm_core.files.output import write_whole
    from omm_core.planning.other_programs import program_text
    from omm_core.planning.plan_file import program_json
    from omm_core.planning.plan_program import plan_program
    from omm_core.planning.wish import Wish
    from omm_report.plan_text import plan_text
    from omm_runs.planning import PlanRequest, plan_of

    if args.part_turned is not None and args.part_at is None:
        raise InputError("Expected --part-at beside --part-turned.")
    place, angle = args.want or (None, None)
    plan = plan_of(
        PlanRequest(
            part_file=args.part,
            calibration_file=args.calibration,
            machine_file=args.machine,
            part_at_mm=None if args.part_at is None else tuple(args.part_at),
            part_turned_rad=tuple(args.part_turned or (0.0, 0.0, 0.0)),
            near=args.near,
            wish=Wish(
                place_mm=place, angle_mm_per_m=angle, point_mm=args.want_point, bump_mm=args.bump
            ),
        )
    )
    result = plan.to_json()
    program = None
    if plan.reached:
        search = args.search is not None
        program = plan_program(plan, limit_mm=args.search if search else args.limit, search=search)
        result["program"] = program_json(plan, program)
    if args.json is not None:
        write_whole(args.json, json.dumps(result, indent=1, allow_nan=False) + "\n")
    print(plan_text(plan))
    if args.picture is not None:
        from omm_report.plan_picture import save_plan_picture

        save_plan_picture(plan, args.picture)
    if args.report is not None:
        from omm_report.plan_report import save_plan_report

        save_plan_report(plan, args.report)
    if program is None:
        raise MeasurementError(f"{plan.findings[0]} No program is written.")
    if args.out is not None:
        write_whole(args.out, program_text(program, args.control))
    return 0


def _two(text: str) -> tuple[float, float]:
    place, angle = (float(word) for word in text.split(","))
    return place, angle
