"""./omm report: a measurement as a document that cites its recording."""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "runs", metavar="RUN", nargs="+", type=Path, help="recordings; before and after, in order"
    )
    parser.add_argument("--part", metavar="FILE", type=Path, help="part file (default: the run's)")
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="calibration (default: the run's)"
    )
    parser.add_argument(
        "--language", choices=("en", "de", "es", "eu"), default="en", help="default: en"
    )
    parser.add_argument(
        "--about", metavar="FILE", type=Path,
        help="laboratory, customer, equipment … (default: report.yaml beside the first run)",
    )  # fmt: skip
    parser.add_argument(
        "--budget", metavar="FILE", type=Path, help="budget.yaml whose summary is added"
    )
    parser.add_argument(
        "--out", metavar="PDF", type=Path, default=Path("report.pdf"), help="default: report.pdf"
    )


def run(arguments: argparse.Namespace) -> int:
    """Solve the runs and write the document."""
    from omm_core.errors import MeasurementError
    from omm_core.files.output import write_whole
    from omm_report.about import about_of
    from omm_report.run_report import run_report
    from omm_runs.budgeting import budget_from, load_sources
    from omm_runs.solving import SolveRunOptions, solve_run

    about = about_of(arguments.runs[0], arguments.about)
    options = SolveRunOptions(part_file=arguments.part, calibration_file=arguments.calibration)
    solved = [solve_run(path, options) for path in arguments.runs]
    for one in solved:
        if not one.result.determined or not one.result.solution.converged:
            reasons = "; ".join([*one.result.missing, *one.result.findings])
            raise MeasurementError(f"{one.run} has no result to report: {reasons}.")
    budget = None
    named = arguments.budget or about.budget
    if named is not None:
        budget = budget_from(load_sources(named))
    report = run_report(solved, arguments.language, about=about, budget=budget)
    write_whole(arguments.out, report)
    print(arguments.out)
    return 0
