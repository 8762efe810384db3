"""./omm survey: coordinates of targets from photographs taken by hand."""

import argparse
import json
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("set", metavar="SET", type=Path, help="a survey.yaml or its folder")
    parser.add_argument("--out", metavar="POINTS.json", type=Path, help="write the coordinates")
    parser.add_argument("--json", metavar="OUT", type=Path, help="write the result as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Survey and print what came out."""
    from omm_core.files.output import write_whole
    from omm_runs.survey_result import write_points
    from omm_runs.surveying import survey

    found = survey(arguments.set)
    result = found.json
    if arguments.json is not None:
        write_whole(arguments.json, json.dumps(result, indent=1, allow_nan=False) + "\n")
    if arguments.out is not None:
        write_points(arguments.out, found)
    used = sum(photo["used"] for photo in result["photos"])
    coded = sum(point["coded"] for point in result["points"])
    print(
        f"{coded} coded and {len(result['points']) - coded} plain targets"
        f" from {used} of {len(result['photos'])} photographs"
        f"\nresiduals {result['rms_px']:.4f} px rms, {result['sigma0']:.2f} times what the"
        f" detector expects; {result['degrees_of_freedom']} degrees of freedom"
    )
    for kind in ("scale_bars", "check_bars"):
        for bar in result[kind]:
            name = f"{kind[:-5]} bar {bar['ends'][0]}-{bar['ends'][1]}"
            print(
                f"{name}: {bar['measured_mm']:.4f} mm, {bar['measured_mm'] - bar['length_mm']:+.4f}"
                f" against its length (sigma {bar['sigma_mm']:.4f})"
            )
    print("\n".join(result["findings"]))
    return 0 if result["converged"] else 1
