"""./omm probe: probed points against the part's pose."""

import argparse
import json
from pathlib import Path

from omm_bringup.values import take_negative_numbers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    take_negative_numbers(parser)
    parser.add_argument("run", metavar="RUN", type=Path, help="the measurement: its pose counts")
    parser.add_argument(
        "points",
        metavar="POINTS.csv",
        type=Path,
        help="name,part_x_mm,part_y_mm,part_z_mm,x_mm,y_mm,z_mm[,sigma_mm]",
    )
    parser.add_argument("--part", metavar="FILE", type=Path, help="part file (default: the run's)")
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="calibration (default: the run's)"
    )
    parser.add_argument(
        "--budget", metavar="FILE", type=Path, help="what else makes the points uncertain"
    )
    parser.add_argument(
        "--log", metavar="FILE", type=Path, help="where the probe was, as the control wrote it"
    )
    parser.add_argument(
        "--log-offset", metavar=("X", "Y", "Z"), type=float, nargs=3, default=(0.0, 0.0, 0.0),
        help="mm, added to the log's positions: spindle to tip, or a work offset",
    )  # fmt: skip
    parser.add_argument(
        "--simulate",
        metavar="CSV",
        type=Path,
        help="touch the points in the cell of a simulated run, and write them there",
    )
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument("--report", metavar="PDF", type=Path, help="write it as a document")
    parser.add_argument("--picture", metavar="PNG", type=Path, help="draw the errors")


def run(arguments: argparse.Namespace) -> int:
    """Compare, print, write what was asked for."""
    from omm_core.errors import InputError
    from omm_core.files.output import write_whole
    from omm_core.files.probe_log import with_log
    from omm_core.files.probed import load_probed, probed_csv
    from omm_recording.run_files import find_run
    from omm_report.probing_text import probing_dict, probing_lines
    from omm_runs.probing import check_run
    from omm_runs.solving import SolveRunOptions

    if arguments.log is not None and arguments.simulate is not None:
        raise InputError("Expected either --log or --simulate.")
    nowhere = arguments.log is not None or arguments.simulate is not None
    points = load_probed(arguments.points, probed=not nowhere)
    if arguments.log is not None:
        points = with_log(points, arguments.log, arguments.log_offset)
    if arguments.simulate is not None:
        from omm_simulation.probe import cell_of, touch

        points = touch(cell_of(find_run(arguments.run).folder / "truth.json"), points)
        write_whole(arguments.simulate, probed_csv(points))
    options = SolveRunOptions(part_file=arguments.part, calibration_file=arguments.calibration)
    check = check_run(arguments.run, points, options=options, budget=arguments.budget)
    if arguments.json is not None:
        content = json.dumps(probing_dict(check), indent=1, allow_nan=False)
        write_whole(arguments.json, content + "\n")
    if arguments.report is not None:
        from omm_report.budget_report import probing_document

        write_whole(arguments.report, probing_document(check, str(arguments.run)))
    if arguments.picture is not None:
        from omm_report.budget_figures import figure_png, probing_figure

        write_whole(arguments.picture, figure_png(probing_figure(check)))
    print("\n".join(probing_lines(check)))
    return 0
