"""./omm budget: how uncertain machine coordinates of the part are, and whether that will do."""

import argparse
import json
import os
from dataclasses import replace
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "budget", metavar="BUDGET.yaml", type=Path, help="or the folder that holds it"
    )
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument("--report", metavar="PDF", type=Path, help="write it as a document")
    parser.add_argument(
        "--picture", metavar="PNG", type=Path, help="draw U over the part's CAD, or else its box"
    )


def run(arguments: argparse.Namespace) -> int:
    """Evaluate, print, write what was asked for."""
    from omm_core.files.output import write_whole
    from omm_report.budget_text import budget_lines
    from omm_runs.budget_surface import surface_map_of
    from omm_runs.budgeting import budget_from, load_sources, map_of
    from omm_runs.what_if import what_ifs

    sources = load_sources(arguments.budget)
    budget, box_map = budget_from(sources), map_of(sources)
    surface, told = surface_map_of(sources, Path(os.environ.get("OMM_ROOT", ".")))
    budget = replace(budget, findings=(*budget.findings, *told))
    helps = what_ifs(sources, budget)
    if arguments.json is not None:
        content = budget.to_json_dict() | {
            "map": box_map.to_json_dict(),
            "surface": None if surface is None else surface.to_json_dict(),
            "what_if": [{"what": one.what, "gain": one.gain} for one in helps],
        }
        write_whole(arguments.json, json.dumps(content, indent=1, allow_nan=False) + "\n")
    if arguments.report is not None:
        from omm_report.budget_report import budget_document

        source = str(sources.file.path)
        document = budget_document(budget, box_map, helps, source, surface)
        write_whole(arguments.report, document)
    if arguments.picture is not None:
        from omm_report.budget_figures import figure_png, map_figure
        from omm_report.budget_surface_picture import surface_figure

        figure = map_figure(box_map) if surface is None else surface_figure(surface)
        write_whole(arguments.picture, figure_png(figure))
    print("\n".join(budget_lines(budget, box_map, helps, surface)))
    return 0
