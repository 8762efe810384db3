"""Many recordings solved side by side, one process each; a bad one does not stop the rest."""

import csv
import io
import math
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

from omm_core.errors import OmmError
from omm_core.files.output import write_whole
from omm_core.session.quantities import THETA
from omm_runs.solving import SolveRunOptions, solve_run


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of one run; the numbers are NaN where it failed."""

    run: Path
    status: str
    message: str
    theta: tuple[float, ...]
    sigma: tuple[float, ...]
    expanded_uncertainty: tuple[float, ...]
    rms_px: float
    images_used: int
    images: int


def solve_many(
    runs: Sequence[Path], options: SolveRunOptions, *, jobs: int | None, csv_file: Path | None
) -> int:
    """Solve all runs; print the progress and write the table; 0 if all were solved, else 1."""
    jobs = max(1, min(jobs or len(os.sched_getaffinity(0)), len(runs)))
    outcomes = _solved(runs, replace(options, threads=1), jobs)
    failed = [outcome for outcome in outcomes if outcome.status != "solved"]
    for outcome in failed:
        print(f"omm: {outcome.run}: {outcome.message}", file=sys.stderr)
    table = table_text(outcomes)
    if csv_file is not None:
        write_whole(csv_file, table)
    else:
        print(table, end="")
    print(f"omm: {len(outcomes) - len(failed)} of {len(outcomes)} runs solved", file=sys.stderr)
    return 1 if failed else 0


def _solved(runs: Sequence[Path], options: SolveRunOptions, jobs: int) -> list[Outcome]:
    """Return the outcomes in the order of the runs."""
    outcomes: dict[int, Outcome] = {}
    # Fresh processes: those forked from a process with threads may hang.
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(_solve_one, run, options): k for k, run in enumerate(runs)}
        for future in as_completed(futures):
            k = futures[future]
            try:
                outcomes[k] = future.result()
            except BrokenProcessPool as error:
                outcomes[k] = _failure(runs[k], "crashed", str(error))
            _show(len(outcomes), len(runs), runs[k])
    return [outcomes[k] for k in range(len(runs))]


def _solve_one(run: Path, options: SolveRunOptions) -> Outcome:
    try:
        result = solve_run(run, options).result
    except OmmError as error:
        return _failure(run, "refused", str(error))
    except Exception as error:  # one run that trips over a defect must not cost the others
        return _failure(run, "crashed", f"{type(error).__name__}: {error}")
    solution = result.solution
    if not result.determined or not solution.converged:
        return _failure(run, "not determined", "; ".join(result.missing) or "does not converge")
    return Outcome(
        run=run,
        status="solved",
        message="",
        theta=tuple(float(v) for v in solution.theta),
        sigma=tuple(math.sqrt(max(float(v), 0.0)) for v in solution.covariance.diagonal()),
        expanded_uncertainty=tuple(float(v) for v in solution.expanded_uncertainty),
        rms_px=float(solution.rms_px),
        images_used=sum(image.used for image in result.images),
        images=len(result.images),
    )


def _failure(run: Path, status: str, message: str) -> Outcome:
    nothing = (math.nan,) * len(THETA)
    return Outcome(
        run=run,
        status=status,
        message=message,
        theta=nothing,
        sigma=nothing,
        expanded_uncertainty=nothing,
        rms_px=math.nan,
        images_used=0,
        images=0,
    )


def table_text(outcomes: Sequence[Outcome]) -> str:
    """Return the outcomes as CSV: one line for each run, in the order given."""
    keys = [quantity.key for quantity in THETA]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = [*keys, *(f"sigma_{key}" for key in keys), *(f"U_{key}" for key in keys), "rms_px"]
    writer.writerow(["run", "status", *columns, "images_used", "images", "message"])
    for o in outcomes:
        values = (*o.theta, *o.sigma, *o.expanded_uncertainty, o.rms_px)
        numbers = ["" if math.isnan(v) else repr(v) for v in values]
        writer.writerow([o.run, o.status, *numbers, o.images_used, o.images, o.message])
    return text.getvalue()


def _show(done: int, total: int, run: Path) -> None:
    again = "\r\033[K" if sys.stderr.isatty() else ""
    end = "" if again and done < total else "\n"
    print(f"{again}omm: {done} of {total} runs, {run}", end=end, file=sys.stderr, flush=True)
