"""./omm fit: place the ideal part in the raw one, with stock everywhere and evenly."""

import argparse
import json
import os
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("fit", metavar="FIT.yaml", type=Path, help="or the folder that holds it")
    parser.add_argument("--out", metavar="PART.yaml", type=Path, help="the coded targets' places")
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")
    parser.add_argument(
        "--faces", action="store_true", help="list the faces of a CAD file (given as FIT.yaml)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Fit, print the overstock of each face, write what was asked for."""
    from omm_core.errors import MeasurementError
    from omm_core.files.output import write_whole
    from omm_core.files.part_writing import part_yaml
    from omm_core.files.points import load_points
    from omm_core.overstock.cad import load_faces
    from omm_core.overstock.fit import fit_part
    from omm_core.overstock.fit_file import load_fit_file

    root = Path(os.environ.get("OMM_ROOT", "."))
    if arguments.faces:
        for number, face in enumerate(load_faces(arguments.fit, root), start=1):
            print(f"{number:4d}  {face.name}")
        return 0
    file = load_fit_file(arguments.fit)
    survey = load_points(file.points)
    fit = fit_part(load_faces(file.cad, root), file, survey)
    result = fit.document
    if arguments.json is not None:
        write_whole(arguments.json, json.dumps(result, indent=1, allow_nan=False) + "\n")
    for row in result["groups"]:
        print(
            f"{row['name']:48s} {row['points']:4d} points  smallest {row['minimum_mm']:8.3f} mm"
            f"  mean {row['mean_mm']:8.3f}  required {row['required_mm']:.3f}  {row['verdict']}"
        )
    print(
        f"Smallest margin {result['minimum_margin_mm']:.4f} mm,"
        f" U {fit.smallest_margin_uncertainty_mm:.4f} mm; limited by"
        f" {', '.join(result['limiting']) or 'nothing'}"
    )
    print("\n".join(f"note: {finding}" for finding in result["findings"]))
    if not result["feasible"]:
        raise MeasurementError(
            f"No placement leaves enough material: {result['missing_mm']:.3f} mm are missing"
            f" between {' and '.join(result['limiting'])} each. part.yaml is not written."
        )
    if arguments.out is not None:
        text = part_yaml(
            name=file.cad.stem,
            target_family=survey.target_family,
            targets=fit.targets,
            covariance_mm2=fit.covariance_mm2,
        )
        write_whole(arguments.out, text)
    return 0
