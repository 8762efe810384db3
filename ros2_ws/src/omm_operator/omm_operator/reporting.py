"""Makes the report of a recording in a process of its own: `python -m omm_operator.reporting`."""

import os
import sys
from pathlib import Path

from omm_core.errors import OmmError
from omm_core.files.output import write_whole
from omm_report.run_report import run_report
from omm_runs.solving import SolveRunOptions, solve_run

_NICENESS = 10


def main(arguments: list[str]) -> int:
    """Write the report of the recording ``arguments[0]`` to ``arguments[1]``."""
    recording, out = map(Path, arguments)
    os.nice(_NICENESS)
    try:
        write_whole(out, run_report([solve_run(recording, SolveRunOptions())]))
    except OmmError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
