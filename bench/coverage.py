"""How often an error lies inside its U on machines that err, and how wide U is for that.

    ./omm exec python bench/coverage.py [--cells 'stops3-*-t4-*' …] [--runs 1000] [--finds 200]

Every run draws a part, a machine and its errors anew (`omm_core.machine_errors`), and solves what
the camera would see with nothing about the machine told. A line is one cell:

    refused   runs without a solution
    lost      clean runs in which anything was left out (false alarms)
    inside    share of errors inside U in percent: all parameters, and the worst one
    width     U over that of a solver that knows all noise, mean over runs: all parameters, and
              the worst one; median over runs of all parameters
    known     share of that solver's own errors inside its U: 95.45, or the harness is wrong

Own: in the machine's own coordinates; absolute: in an ideal machine's. With --finds, also how
often a bumped target, the pose of another image and a misread number are found and rightly named.
With --any, every run is on another machine, out of all that must be solved.
"""

import argparse
import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

sys.path[:0] = [
    str(Path(__file__).resolve().parents[1] / "ros2_ws/src/omm_core" / folder)
    for folder in ("", "test")
]

from core_coverage import ABSOLUTE, OWN, WRONGS, all_cells, any_cell, finds, measure  # noqa: E402

from omm_core.part_pose import THETA_NAMES  # noqa: E402

CHUNK = 20  # runs that a worker does at a time


def measure_chunk(cell, first, count):
    """Return the tally of runs, one seed after the other."""
    tallies = [measure(cell, seed) for seed in range(first, first + count)]
    return sum(tallies[1:], tallies[0])


def any_chunk(first, count):
    """Return the tally of runs, each on another machine."""
    tallies = [measure(any_cell(seed), seed) for seed in range(first, first + count)]
    return sum(tallies[1:], tallies[0])


def finds_chunk(cell, wrong, first, count):
    """Return how many of the wrong things were found and rightly named."""
    return sum(finds(cell, wrong, seed) for seed in range(first, first + count))


def run_all(cells, runs, wrongs):
    """Return tallies by cell, and finds by cell and kind."""
    tallies, found = {}, {}
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        chunks = {
            pool.submit(measure_chunk, cell, first, min(CHUNK, runs - first)): (cell, None)
            for cell in cells
            for first in range(0, runs, CHUNK)
        }
        chunks |= {
            pool.submit(finds_chunk, cell, wrong, first, min(CHUNK, wrongs - first)): (cell, wrong)
            for cell in cells
            for wrong in WRONGS
            for first in range(0, wrongs, CHUNK)
        }
        begin = time.monotonic()
        for done, chunk in enumerate(as_completed(chunks), start=1):
            cell, wrong = chunks[chunk]
            result = chunk.result()
            if wrong is None:
                tallies[cell] = tallies[cell] + result if cell in tallies else result
            else:
                found[cell, wrong] = found.get((cell, wrong), 0) + result
            tell_progress(done, len(chunks), time.monotonic() - begin)
    return tallies, found


def run_any(runs):
    """Print one line over machines drawn from all that must be solved."""
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        firsts = range(0, runs, CHUNK)
        counts = [min(CHUNK, runs - first) for first in firsts]
        tallies = []
        begin = time.monotonic()
        for done, tally in enumerate(pool.map(any_chunk, firsts, counts), start=1):
            tallies.append(tally)
            tell_progress(done, len(counts), time.monotonic() - begin)
    row = row_of(sum(tallies[1:], tallies[0]))
    print(
        f"{runs} machines: stops 0 to 20 µm, geometry 0 to 50 µm, correlation 0.2 to 4 diagonals,"
        " targets 0 to 0.1 mm, detector 1 to 5 times worse; 4, 6 or 8 targets"
    )
    print(f"refused {row['refused']}, lost {row['lost']}")
    for name in ("own", "absolute"):
        inside = ", ".join(f"{100 * share:.1f}" for share in row[name]["inside"])
        width = ", ".join(f"{ratio:.2f}" for ratio in row[name]["width"])
        print(f"{name}: inside U {inside} %; width {width}")


def tell_progress(done, of, seconds):
    """Say on the terminal how far it is, and for how long it will last."""
    if sys.stderr.isatty() or done == of or done % 50 == 0:
        left = seconds / done * (of - done)
        print(f"{done} of {of} chunks, {left:.0f} s left", file=sys.stderr, flush=True)


def row_of(tally):
    """Return the numbers of a line."""
    solved = tally.runs - tally.refused or np.nan  # nothing can be said of none
    return {
        "runs": tally.runs,
        "refused": tally.refused,
        "lost": tally.lost,
        **{
            name: {
                "inside": (tally.inside[k] / solved).tolist(),
                "width": mean_of(tally.widths[:, k]),
                "median_width": median_of(tally.widths[:, k]),
                "known_inside": (tally.known_inside[k] / tally.runs).tolist(),
            }
            for name, k in (("own", OWN), ("absolute", ABSOLUTE))
        },
    }


def mean_of(widths):
    """Return the mean of each parameter, NaN without runs."""
    return widths.mean(axis=0).tolist() if len(widths) else [np.nan] * 7


def median_of(widths):
    """Return the median of each parameter, NaN without runs."""
    return np.median(widths, axis=0).tolist() if len(widths) else [np.nan] * 7


def print_table(rows, found, wrongs):
    """Print a line for each cell."""
    width = max(len(cell.name) for cell in rows)
    print(f"{'':{width}}              own, inside % and width              absolute")
    print(
        f"{'cell':{width}} refused lost"
        + "    all  worst  width  worst median" * 2
        + " known"
        + "".join(f"  {wrong:>10}" for wrong in WRONGS if wrongs)
    )
    for cell, row in rows.items():
        numbers = []
        for name in ("own", "absolute"):
            inside, ratio = 100.0 * np.array(row[name]["inside"]), np.array(row[name]["width"])
            numbers += [inside.mean(), inside.min(), ratio.mean(), ratio.max()]
            numbers += [np.mean(row[name]["median_width"])]
        known = 100.0 * np.mean(row["own"]["known_inside"])
        shown = "".join(f"{n:7.{d}f}" for n, d in zip(numbers, (1, 1, 2, 2, 2) * 2))
        print(
            f"{cell.name:{width}} {row['refused']:7} {row['lost']:4}{shown}{known:6.1f}"
            + "".join(f"  {found[cell, w] / wrongs:10.3f}" for w in WRONGS if wrongs)
        )


def print_summary(rows):
    """Print the figures that the whole table is judged by, over the cells measured."""
    groups = {
        "1.5 x 1 m": lambda c: c.targets < 8 and c.stop_um > 0 and plain(c),
        "10 x 3 m": lambda c: c.targets == 8 and c.stop_um > 0 and plain(c),
        "stops 0": lambda c: c.stop_um == 0 and plain(c),
        "detector 4 times worse": lambda c: c.detector != 1.0,
        "declared": lambda c: c.declared,
    }
    print("\nwidth: mean of a cell's parameters and runs")
    for name, belongs in groups.items():
        chosen = {cell: row for cell, row in rows.items() if belongs(cell)}
        if not chosen:
            continue
        inside = np.array([row["own"]["inside"] for row in chosen.values()])
        inside = np.nan_to_num(inside)  # refused is not inside
        widths = np.array([row["own"]["width"] for row in chosen.values()]).mean(axis=1)
        medians = np.array([row["own"]["median_width"] for row in chosen.values()]).mean(axis=1)
        at = np.unravel_index(np.argmin(inside), inside.shape)
        print(
            f"own, {name}: worst inside {100 * inside[at]:.1f} % ({THETA_NAMES[at[1]]},"
            f" {list(chosen)[at[0]].name}); width median {np.nanmedian(widths):.2f},"
            f" worst {np.nanmax(widths):.2f} ({list(chosen)[int(np.nanargmax(widths))].name});"
            f" by the median of a cell's runs: {np.nanmedian(medians):.2f},"
            f" worst {np.nanmax(medians):.2f}"
        )
        short = {c: r for c, r in chosen.items() if c.correlation <= 0.4 or c.geometry_um == 0}
        if short:
            inside = np.array([row["absolute"]["inside"] for row in short.values()])
            print(
                f"absolute, {name}, correlation up to 0.4: pooled {100 * inside.mean():.1f} %,"
                f" worst parameter of a cell {100 * inside.min():.1f} %"
            )


def plain(cell):
    """Whether nothing is declared and the detector is as good as it says."""
    return not cell.declared and cell.detector == 1.0


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", nargs="+", default=["*"], help="patterns of names (all)")
    parser.add_argument("--runs", type=int, default=200, help="measurements a cell (%(default)s)")
    parser.add_argument("--finds", type=int, default=0, help="wrong ones a cell and kind (0)")
    parser.add_argument(
        "--any", type=int, default=0, metavar="N", help="instead, N machines of any size"
    )
    parser.add_argument("--list", action="store_true", help="print the cells' names only")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write all numbers")
    arguments = parser.parse_args()
    if arguments.any:
        measure(any_cell(0), 0)
        run_any(arguments.any)
        return
    cells = [c for c in all_cells() if any(fnmatch(c.name, p) for p in arguments.cells)]
    if arguments.list or not cells:
        print("\n".join(cell.name for cell in (cells or all_cells())))
        return
    measure(cells[0], 0)  # compile or load, before there are workers
    tallies, found = run_all(cells, arguments.runs, arguments.finds)
    rows = {cell: row_of(tallies[cell]) for cell in cells}
    print_table(rows, found, arguments.finds)
    print_summary(rows)
    if arguments.json:
        content = {
            cell.name: row | {w: found[cell, w] / arguments.finds for w in WRONGS if found}
            for cell, row in rows.items()
        }
        arguments.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
