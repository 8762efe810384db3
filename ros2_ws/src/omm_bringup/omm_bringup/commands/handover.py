"""./omm handover: the part's pose in a control's own words."""

import argparse
from pathlib import Path

from omm_bringup.values import take_negative_numbers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    take_negative_numbers(parser)
    parser.add_argument("run", metavar="RUN", nargs="?", type=Path, help="a recording")
    parser.add_argument(
        "--theta",
        nargs=6,
        type=float,
        metavar=("ALPHA", "BETA", "GAMMA", "X", "Y", "Z"),
        help="instead of RUN: the pose, rad and mm",
    )
    parser.add_argument("--part", metavar="FILE", type=Path, help="part file (default: the run's)")
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="calibration (default: the run's)"
    )
    parser.add_argument("--machine", metavar="FILE", type=Path, help="machine file")
    parser.add_argument(
        "--control", required=True, help="linuxcnc, siemens, heidenhain, fanuc or fagor"
    )
    parser.add_argument("--offset", metavar="NAME", help="G54 (default), a preset's number (1), …")
    parser.add_argument(
        "--remaining",
        metavar="MM",
        type=float,
        default=0.1,
        help="what a corner of the part may be off by (default 0.1)",
    )
    parser.add_argument("--out", metavar="FILE", type=Path, help="default: printed")


def run(arguments: argparse.Namespace) -> int:
    """Write the file, or print it."""
    from omm_core.files.output import write_whole
    from omm_runs.handing_over import HandoverOptions, handover_of

    handed = handover_of(
        HandoverOptions(
            run=arguments.run,
            theta=None if arguments.theta is None else tuple(arguments.theta),
            part_file=arguments.part,
            calibration_file=arguments.calibration,
            machine_file=arguments.machine,
            control=arguments.control,
            offset=arguments.offset,
            remaining_mm=arguments.remaining,
        )
    )
    if arguments.out is None:
        print(handed.text, end="")
        return 0
    write_whole(arguments.out, handed.text)
    print(f"{arguments.out}: largest error at a corner of the part {handed.error_mm:.4f} mm")
    return 0
