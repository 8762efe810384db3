"""./omm repeatability: the paper's tables 2 and 3, short for a simulated campaign."""

import argparse
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
    """Have the campaign done: one measurement in each clamping, 6D and 7D beside the paper's."""
    from omm_bringup.commands import campaign

    parser = argparse.ArgumentParser()
    campaign.add_arguments(parser)
    words = ["--clampings", str(args.clampings), "--scenario", args.scenario]
    asked = parser.parse_args(words + ([] if args.fast else ["--images"]))
    # Numbers go on as they are: the campaign judges them.
    asked.seed, asked.noise_px, asked.json = args.seed, args.noise_px, args.json
    return campaign.run(asked)
