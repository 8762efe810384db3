"""./omm budget: how uncertain machine coordinates of the part are, and whether that will do."""

import argparse
import json
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "budget", metavar="BUDGET.yaml", type=Path, help="or the folder that holds it"
    )
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate, print, write what was asked for."""
    from omm_core.files.output import write_whole
    from omm_report.budget_text import budget_lines
    from omm_runs.budgeting import budget_of

    budget = budget_of(arguments.budget)
    if arguments.json is not None:
        content = json.dumps(budget.to_json_dict(), indent=1, allow_nan=False)
        write_whole(arguments.json, content + "\n")
    print("\n".join(budget_lines(budget)))
    return 0
