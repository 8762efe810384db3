"""./omm fit: place the ideal part in the raw one, with stock everywhere and evenly."""

import argparse
import json
import os
from dataclasses import replace
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("fit", metavar="FIT.yaml", type=Path, help="or the folder that holds it")
    parser.add_argument("--out", metavar="PART.yaml", type=Path, help="the coded targets' places")
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument("--report", metavar="PDF", type=Path, help="write the result as a document")
    parser.add_argument("--page", metavar="HTML", type=Path, help="write the part in 3D, as a page")
    parser.add_argument("--pictures", metavar="FOLDER", type=Path, help="write PNGs")
    parser.add_argument(
        "--placement", metavar="N", type=int, help="which of several that fit as well, from 1"
    )
    parser.add_argument(
        "--what-if", metavar="GROUP=MM", action="append", default=[],
        help="fit again with this allowance changed by so much (base=-0.5), before and after",
    )  # fmt: skip
    parser.add_argument(
        "--faces", action="store_true", help="list and draw the faces of a CAD file (as FIT.yaml)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Fit, print the overstock of each face, write what was asked for."""
    from omm_core.files.output import write_whole
    from omm_core.files.part import Part, part_yaml
    from omm_core.files.points import load_points
    from omm_core.overstock.cad import load_faces
    from omm_core.overstock.fit import fit_part
    from omm_core.overstock.fit_file import load_fit_file
    from omm_core.overstock.fit_words import fit_text, refuse
    from omm_core.overstock.what_if import parse_changes, what_if
    from omm_report.fit_outputs import show_faces, what_if_text, write_pictures
    from omm_report.fit_page import fit_page
    from omm_report.fit_report import fit_document

    root = Path(os.environ.get("OMM_ROOT", "."))
    if arguments.faces:
        show_faces(arguments.fit, root, arguments.pictures)
        return 0
    changes = parse_changes(arguments.what_if)
    file = load_fit_file(arguments.fit)
    if arguments.placement is not None:
        file = replace(file, placement=arguments.placement)
    survey = load_points(file.points)
    fit = fit_part(load_faces(file.cad, root, file.cad_unit_mm), file, survey)
    other = what_if(fit, survey, changes) if changes else None
    if other is not None:
        fit.document["what_if"] = {"changes_mm": changes, "result": other.fit.document}
    if arguments.json is not None:
        write_whole(arguments.json, json.dumps(fit.document, indent=1, allow_nan=False) + "\n")
    print(fit_text(fit))
    if other is not None:
        print(what_if_text(fit, other))
    if arguments.report is not None:
        write_whole(arguments.report, fit_document(fit, str(arguments.fit), other))
    if arguments.page is not None:
        write_whole(arguments.page, fit_page(fit))
    if arguments.pictures is not None:
        write_pictures(arguments.pictures, fit, other)
    refuse(fit)
    if arguments.out is not None:
        part = Part(
            name=file.cad.stem,
            target_family=survey.target_family,
            targets=fit.targets,
            covariance_mm2=fit.covariance_mm2,
            box_mm=fit.box_mm,
        )
        write_whole(arguments.out, part_yaml(part))
    return 0
