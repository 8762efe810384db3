"""./omm solve: solve recordings again, without ROS running."""

import argparse
import json
import sys
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "runs", metavar="RUN", nargs="+", type=Path, help="an MCAP file or a run's folder"
    )
    parser.add_argument("--part", metavar="FILE", type=Path, help="part file (default: the run's)")
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="calibration (default: the run's)"
    )
    parser.add_argument(
        "--machine",
        metavar="FILE",
        type=Path,
        help="machine.yaml: how exact it is (default: as measured live, or else estimated)",
    )
    parser.add_argument(
        "--model", choices=("7d", "6d"), help="default: as measured live, or else 7d"
    )
    parser.add_argument(
        "--gamma-s",
        metavar="RAD",
        type=float,
        help="clamping angle of the 6d model (default: as measured live, or else 0)",
    )
    parser.add_argument(
        "--tolerance",
        metavar="MM",
        type=float,
        help="what a spindle that stands still may move by",
    )
    parser.add_argument(
        "--without",
        metavar="STAMP",
        type=int,
        nargs="+",
        default=[],
        help="stamps (ns) of images to leave out",
    )
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument("--csv", metavar="OUT", type=Path, help="one line for each run")
    parser.add_argument(
        "--jobs", metavar="N", type=int, help="runs solved side by side (default: one per core)"
    )
    parser.add_argument(
        "--image-topic",
        default="/camera/image_raw",
        help="images in a recording made elsewhere (default: %(default)s)",
    )
    parser.add_argument(
        "--pose-topic",
        default="/cnc/spindle_pose",
        help="the spindle's poses there (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Solve one run and print it, or many and write a table."""
    options = _options(arguments)
    if len(arguments.runs) > 1 or arguments.csv is not None:
        return _many(arguments, options)
    from omm_runs.solving import solve_run

    return _print(solve_run(arguments.runs[0], options), arguments.json)


def _options(arguments: argparse.Namespace):  # type: ignore[no-untyped-def]
    from omm_runs.solving import SolveRunOptions

    given = {
        "model": arguments.model,
        "gamma_s_rad": arguments.gamma_s,
        "standstill_tolerance_mm": arguments.tolerance,
    }
    return SolveRunOptions(
        part_file=arguments.part,
        calibration_file=arguments.calibration,
        machine_file=arguments.machine,
        settings={name: value for name, value in given.items() if value is not None},
        without=frozenset(arguments.without),
        image_topic=arguments.image_topic,
        pose_topic=arguments.pose_topic,
    )


def _print(solved, out: Path | None) -> int:  # type: ignore[no-untyped-def]
    from omm_core.errors import MeasurementError
    from omm_core.files.output import write_whole
    from omm_core.printable import printable
    from omm_report.solution_text import solution_lines

    for notice in solved.notices:
        print(printable(f"omm: {notice}"), file=sys.stderr)
    result = solved.result
    if not result.determined or not result.solution.converged:
        raise MeasurementError(_why_not(solved))
    if out is not None:
        write_whole(out, json.dumps(result.to_json_dict(), indent=1, allow_nan=False) + "\n")
    print("\n".join(solution_lines(solved)))
    return 0


def _why_not(solved) -> str:  # type: ignore[no-untyped-def]
    from omm_core.words import image_number

    result = solved.result
    reasons = [*result.missing, *result.findings]
    if result.determined:
        reasons.insert(0, "the solution does not converge")
    run_ns = [image.stamp_ns for image in result.images]
    reasons += [
        f"image {image_number(i.stamp_ns, run_ns)}: {i.reason}" for i in result.images if not i.used
    ]
    return f"{solved.run} cannot be solved.\n  " + "\n  ".join(reasons)


def _many(arguments: argparse.Namespace, options) -> int:  # type: ignore[no-untyped-def]
    from omm_core.errors import InputError
    from omm_runs.solving_many import solve_many

    if arguments.json is not None:
        raise InputError("--json is for one run; the table of many goes to --csv OUT.")
    return solve_many(arguments.runs, options, jobs=arguments.jobs, csv_file=arguments.csv)
