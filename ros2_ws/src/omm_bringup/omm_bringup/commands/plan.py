"""./omm plan: where to take images for a wanted uncertainty, as a program."""

import argparse
from pathlib import Path

from omm_bringup.values import take_negative_numbers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    take_negative_numbers(parser)
    add = parser.add_argument
    add("--part", type=Path, required=True, metavar="PART.yaml")
    add("--calibration", type=Path, required=True, metavar="CAMERA.yaml")
    add("--machine", type=Path, required=True, metavar="FILE", help="machine.yaml or URDF")
    about = "about where the part's origin is, mm (default: the part's nominal)"
    add("--part-at", type=float, nargs=3, metavar=("X", "Y", "Z"), help=about)
    turned = "and how it is turned about fixed x, y, z, rad"
    add("--part-turned", type=float, nargs=3, metavar=("A", "B", "G"), help=turned)
    add("--near", type=Path, metavar="RUN", help="where a run found the part")
    add("--want", type=_two, metavar="MM,MM_PER_M", help="U of places, and of angles (mm/m)")
    add("--want-point", type=float, metavar="MM", help="U of the box's worst corner")
    add("--bump", type=float, metavar="MM", help="displaced targets that are to be noticed")
    least = "what is to be least: images (default) or time, machine time"
    add("--least", choices=("images", "time"), default="images", help=least)
    add("--out", type=Path, metavar="PROGRAM.ngc", help="the measuring program")
    templates = "of the program: linuxcnc; templates: siemens, heidenhain, fanuc, fagor"
    add("--control", default="linuxcnc", help=templates)
    limit = "largest correction of a stop (%(default)g)"
    add("--limit", type=float, default=50.0, metavar="MM", help=limit)
    search = "the part may lie that far off: begin from afar, look around, correct by so much"
    add("--search", type=float, metavar="MM", help=search)
    add("--picture", type=Path, metavar="PNG", help="part and stops")
    add("--report", type=Path, metavar="PDF")
    add("--json", type=Path, metavar="OUT")


def run(args: argparse.Namespace) -> int:
    """Plan, print, and write what was asked for; 1 where the wish cannot be reached."""
    from omm_core.errors import InputError, MeasurementError
    from omm_core.planning.wish import PlanWish
    from omm_report.plan_output import PlanOutputs, write_no_plan, write_plan
    from omm_report.plan_text import plan_text
    from omm_runs.planning import PlanRequest, plan_of

    if args.part_turned is not None and args.part_at is None:
        raise InputError("Expected --part-at beside --part-turned.")
    if args.least == "time" and not (args.want or args.want_point or args.bump):
        raise InputError("--least time needs a wish: --want, --want-point or --bump.")
    place, angle = args.want or (None, None)
    request = PlanRequest(
        part_file=args.part,
        calibration_file=args.calibration,
        machine_file=args.machine,
        part_at_mm=None if args.part_at is None else tuple(args.part_at),
        part_turned_rad=tuple(args.part_turned or (0.0, 0.0, 0.0)),
        near=args.near,
        wish=PlanWish(
            place_mm=place,
            angle_mm_per_m=angle,
            point_mm=args.want_point,
            bump_mm=args.bump,
            least_time=args.least == "time",
        ),
    )
    try:
        plan = plan_of(request)
    except MeasurementError as error:
        if args.json is not None:
            write_no_plan(str(error), args.json)
        raise
    outputs = PlanOutputs(
        json=args.json, program=args.out, picture=args.picture, report=args.report,
        control=args.control, limit_mm=args.limit, search_mm=args.search,
    )  # fmt: skip
    write_plan(plan, outputs)
    print(plan_text(plan))
    if not plan.reached:
        raise MeasurementError(f"{plan.findings[0]} No program is written.")
    return 0


def _two(text: str) -> tuple[float, float]:
    try:
        place, angle = (float(word) for word in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected MM,MM_PER_M as 0.05,0.05, got {text}") from None
    return place, angle
