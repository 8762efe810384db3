"""./omm survey: coordinates of targets from photographs taken by hand."""

import argparse
import json
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "set", metavar="SET", type=Path,
        help="a survey.yaml, its folder, or a folder with AICON's export of a network (.phc ...)",
    )  # fmt: skip
    parser.add_argument("--out", metavar="POINTS.json", type=Path, help="write the coordinates")
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument("--report", metavar="PDF", type=Path, help="write a document")
    parser.add_argument("--pictures", metavar="FOLDER", type=Path, help="write its pictures as PNG")
    parser.add_argument(
        "--lengths", metavar="CSV", type=Path,
        help="calibrated lengths to accept the survey by: first,second,length_mm",
    )  # fmt: skip
    parser.add_argument(
        "--limit", metavar=("MM", "MM_PER_M"), type=float, nargs=2, default=(0.05, 0.02),
        help="limit of a length's error: constant and per metre (0.05 0.02)",
    )  # fmt: skip
    parser.add_argument(
        "--scene", metavar="HTML", type=Path, help="write the network as a scene for the browser"
    )


def run(arguments: argparse.Namespace) -> int:
    """Survey and print what came out."""
    from omm_core.errors import InputError
    from omm_core.files.aicon import is_aicon
    from omm_core.files.output import write_whole
    from omm_report.survey_text import survey_text
    from omm_runs.survey_acceptance import add_acceptance, check_limit, read_lengths
    from omm_runs.survey_result import write_points
    from omm_runs.surveying import survey
    from omm_runs.surveying_measured import survey_measured

    measured = is_aicon(arguments.set)
    if measured and arguments.out is not None:
        raise InputError(
            "Image points measured elsewhere name no family and no dot diameter, which points.json"
            " must: use --json."
        )
    if measured and arguments.lengths is not None:
        raise InputError("--lengths: expected photographs, got image points measured elsewhere.")
    limit = tuple(arguments.limit)
    lengths = []
    if arguments.lengths is not None:  # before minutes are spent on photographs
        check_limit(limit)
        lengths = read_lengths(arguments.lengths)
    found = None if measured else survey(arguments.set)
    result = survey_measured(arguments.set) if found is None else found.json
    passed = True
    if lengths and found is not None:
        passed = add_acceptance(found, lengths, limit)
    if arguments.json is not None:
        write_whole(arguments.json, json.dumps(result, indent=1, allow_nan=False) + "\n")
    if arguments.out is not None and found is not None:
        write_points(arguments.out, found)
    if arguments.report is not None:
        from omm_report.survey_report import survey_document

        write_whole(arguments.report, survey_document(result, arguments.set.name))
    if arguments.pictures is not None:
        from omm_report.survey_pictures import write_pictures

        write_pictures(result, arguments.pictures)
    if arguments.scene is not None:
        from omm_report.survey_scene import survey_scene

        write_whole(arguments.scene, survey_scene(result, f"Survey {arguments.set.name}"))
    print(survey_text(result))
    return 0 if result["converged"] and passed else 1
