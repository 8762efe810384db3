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
    parser.add_argument("--json", type=Path, metavar="OUT")


def run(args: argparse.Namespace) -> int:
    """Plan, print, and write what was asked for; 1 where the wish cannot be reached."""
    from omm_core.errors import InputError, MeasurementError
    from omm_core.files.output import write_whole
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
    if args.json is not None:
        write_whole(args.json, json.dumps(plan.to_json(), indent=1, allow_nan=False) + "\n")
    print(plan_text(plan))
    if not plan.reached:
        raise MeasurementError(f"{plan.findings[0]} No program is written.")
    return 0


def _two(text: str) -> tuple[float, float]:
    place, angle = (float(word) for word in text.split(","))
    return place, angle
