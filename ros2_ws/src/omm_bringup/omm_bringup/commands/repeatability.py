"""./omm repeatability: measure one part over many clampings, with 6D and with 7D."""

import argparse
import json
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--scenario", default="bench", help="(default %(default)s)")
    parser.add_argument("--clampings", type=int, default=10, metavar="N", help="(%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="(%(default)s)")
    parser.add_argument(
        "--fast", action="store_true", help="simulate centres with noise, without images"
    )
    parser.add_argument(
        "--noise-px", type=float, default=0.01, help="with --fast: of a centre (%(default)s)"
    )
    parser.add_argument("--json", metavar="OUT", type=Path, help="write all results as JSON")


def run(args: argparse.Namespace) -> int:
    """Print twice the standard deviations over all clampings, beside the paper's."""
    from omm_core.files.output import write_whole
    from omm_simulation.repeatability import measure_clampings, repeatability, table
    from omm_simulation.scenario import load_scenario

    noise = args.noise_px if args.fast else None
    measured = []
    scenario = load_scenario(args.scenario)
    for clamping in measure_clampings(scenario, args.clampings, args.seed, sigma_px=noise):
        measured.append(clamping)
        if not args.fast:
            print(f"clamping {len(measured)} of {args.clampings} measured", flush=True)
    result = repeatability(measured)
    how = f"centres with {args.noise_px} px noise" if args.fast else "rendered images"
    print(f"\nscenario {args.scenario}, {args.clampings} clampings, seed {args.seed}, {how}")
    print("2 standard deviations over the clampings of what was measured\n")
    print(table(result))
    if args.json:
        content = {
            "truth": result.truth.tolist(),
            "6D": result.six.tolist(),
            "7D": result.seven.tolist(),
        }
        write_whole(args.json, json.dumps(content, indent=1) + "\n")
    return 0
