"""./omm campaign: repeatability, reproducibility and capability, from runs, simulated or live."""

import argparse
import json
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("campaign", metavar="CAMPAIGN.yaml", nargs="?", type=Path, help="which run is which")
    add("--clampings", type=int, metavar="K", help="simulate, or with --live measure, so many")
    add("--repeats", type=int, metavar="N", default=1, help="in each clamping (default 1)")
    add("--scenario", default="bench", help="simulated cell (default %(default)s)")
    add("--seed", type=int, default=1, help="of the simulated cell (%(default)s)")
    add("--noise-px", type=float, default=0.01, help="simulated centres (%(default)s)")
    add("--images", action="store_true", help="simulate images instead of centres")
    add("--live", action="store_true", help="start the nodes, measure and record each run")
    add("--folder", type=Path, help="with --live: where the runs go (default: runs/DATE-campaign)")
    add(
        "--camera",
        help="with --live: gige, usb3, v4l2 or a parameter file (default: simulated)",
    )
    add("--control", help="with --camera: linuxcnc, opcua, mtconnect or a parameter file")
    add("--part", metavar="FILE", type=Path, help="with --camera: part file")
    add("--calibration", metavar="FILE", type=Path, help="with --camera: calibration")
    add("--machine", metavar="FILE", type=Path, help="with --camera: machine file")
    add("--scheduler", metavar="ADDRESS", help="spread over a Dask scheduler's workers")
    add("--jobs", type=int, metavar="N", help="processes side by side (default: one per core)")
    add("--json", metavar="OUT", type=Path, help="write the result as JSON")
    add("--report", metavar="PDF", type=Path, help="write it as a document")
    add("--picture", metavar="PNG", type=Path, help="draw it, by clamping")


def run(arguments: argparse.Namespace) -> int:
    """Solve, simulate or measure; print the tables; write what was asked for."""
    from omm_bringup.campaigning import campaign_and_source
    from omm_core.files.output import write_whole
    from omm_report.campaign_text import campaign_dict, campaign_lines

    campaign, source = campaign_and_source(arguments)
    beside_paper = arguments.campaign is None
    if arguments.json is not None:
        content = json.dumps(campaign_dict(campaign), indent=1, allow_nan=False)
        write_whole(arguments.json, content + "\n")
    if arguments.report is not None:
        from omm_report.budget_report import campaign_document

        document = campaign_document(campaign, source, beside_paper=beside_paper)
        write_whole(arguments.report, document)
    if arguments.picture is not None:
        from omm_report.budget_figures import campaign_figure, figure_png

        write_whole(arguments.picture, figure_png(campaign_figure(campaign)))
    print("\n".join(campaign_lines(campaign, beside_paper=beside_paper)))
    return 0
