"""./omm campaign: repeatability, reproducibility and capability, from runs or simulated."""

import argparse
import json
import sys
from functools import partial
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "campaign", metavar="CAMPAIGN.yaml", nargs="?", type=Path, help="which run is which"
    )
    parser.add_argument("--clampings", type=int, metavar="K", help="simulate so many clampings")
    parser.add_argument("--repeats", type=int, metavar="N", help="in each clamping (default 1)")
    parser.add_argument("--scenario", default="bench", help="(default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="(%(default)s)")
    parser.add_argument("--noise-px", type=float, default=0.01, help="of a centre (%(default)s)")
    parser.add_argument(
        "--images", action="store_true", help="render and search images instead of drawing centres"
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="spread over a Dask scheduler's workers"
    )
    parser.add_argument("--jobs", type=int, metavar="N", help="processes (default: one a core)")
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument("--report", metavar="PDF", type=Path, help="write it as a document")
    parser.add_argument("--picture", metavar="PNG", type=Path, help="draw it, by clamping")


def run(arguments: argparse.Namespace) -> int:
    """Solve or simulate, print the tables, write what was asked for."""
    from omm_core.errors import InputError
    from omm_core.files.output import write_whole
    from omm_report.campaign_text import campaign_dict, campaign_lines
    from omm_runs.campaigning import campaign_of

    spread_over = {"jobs": arguments.jobs, "scheduler": arguments.scheduler, "progress": _show}
    if (arguments.campaign is None) == (arguments.clampings is None):
        raise InputError("Expected either CAMPAIGN.yaml or --clampings K.")
    if arguments.campaign is not None:
        campaign, _ = campaign_of(arguments.campaign, **spread_over)
    else:
        campaign = _simulated(arguments, spread_over)
    if arguments.json is not None:
        content = json.dumps(campaign_dict(campaign), indent=1, allow_nan=False)
        write_whole(arguments.json, content + "\n")
    _documents(arguments, campaign)
    print("\n".join(campaign_lines(campaign, beside_paper=arguments.campaign is None)))
    return 0


def _documents(arguments: argparse.Namespace, campaign) -> None:  # type: ignore[no-untyped-def]
    from omm_core.files.output import write_whole

    simulated = arguments.campaign is None
    if arguments.report is not None:
        from omm_report.budget_report import campaign_document

        source = (
            f"simulation, scenario {arguments.scenario}, seed {arguments.seed}"
            if simulated
            else str(arguments.campaign)
        )
        write_whole(arguments.report, campaign_document(campaign, source, beside_paper=simulated))
    if arguments.picture is not None:
        from omm_report.budget_figures import campaign_figure, figure_png

        write_whole(arguments.picture, figure_png(campaign_figure(campaign)))


def _simulated(arguments, spread_over):
    from omm_core.budget.campaign import evaluate_campaign
    from omm_core.errors import InputError
    from omm_runs.campaigning import full_widths
    from omm_runs.spreading import spread
    from omm_simulation.clampings import ClampingSettings, measure_clampings
    from omm_simulation.scenario import load_scenario

    settings = ClampingSettings(
        scenario=arguments.scenario,
        seed=arguments.seed,
        repeats=1 if arguments.repeats is None else arguments.repeats,
        noise_px=arguments.noise_px,
        images=arguments.images,
    )
    if arguments.clampings * settings.repeats < 2:
        raise InputError("Expected at least 2 measurements: more --clampings or --repeats.")
    scenario = load_scenario(settings.scenario)
    size = 1 if settings.images else max(1, min(50, arguments.clampings // 8))
    numbers = range(1, arguments.clampings + 1)
    blocks = [numbers[first : first + size] for first in range(0, len(numbers), size)]
    found = spread(partial(measure_clampings, settings), blocks, **spread_over)
    measured = [one for block in found for one in block]
    return evaluate_campaign(measured, tolerances=full_widths(scenario.part))


def _show(done: int, total: int) -> None:
    if sys.stderr.isatty():
        print(f"\r\033[Komm: {done} of {total}", end="\n" if done == total else "",
              file=sys.stderr, flush=True)  # fmt: skip
