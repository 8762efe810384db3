"""Makes the report of a recording in a process of its own: `python -m omm_operator.reporting`."""

import os
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from omm_core.errors import OmmError
from omm_core.files.output import write_whole
from omm_recording.repairing import repair
from omm_recording.writing import UNFINISHED
from omm_report.about import about_of
from omm_report.run_report import run_report
from omm_runs.budgeting import budget_from, load_sources
from omm_runs.solving import SolveRunOptions, solve_run

_NICENESS = 10


def main(arguments: list[str]) -> int:
    """Write the report of the recording ``arguments[0]`` to ``arguments[1]``, in a language."""
    recording, out, language = Path(arguments[0]), Path(arguments[1]), arguments[2]
    os.nice(_NICENESS)
    try:
        with TemporaryDirectory(prefix="omm-report-") as folder:
            whole = _so_far(recording, Path(folder))
            about = about_of(recording)
            budget = budget_from(load_sources(about.budget)) if about.budget else None
            solved = solve_run(whole, SolveRunOptions())
            write_whole(out, run_report([solved], language, about=about, budget=budget))
    except OmmError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _so_far(recording: Path, folder: Path) -> Path:
    """Return a finished recording: as it is, or a sound copy of one that is being made."""
    unfinished = recording.with_name(recording.name + UNFINISHED)
    if recording.exists() or not unfinished.exists():
        return recording
    copied, whole = folder / unfinished.name, folder / recording.name
    shutil.copyfile(unfinished, copied)
    repair(copied, whole)
    for name in ("part.yaml", "camera.yaml", "machine.yaml"):
        beside = recording.with_name(name)
        if beside.is_file():
            shutil.copyfile(beside, folder / name)
    return whole


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
