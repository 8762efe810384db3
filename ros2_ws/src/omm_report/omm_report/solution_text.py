"""A solved run as people read it: a table in mm and mm/m, and what became of the images."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from omm_core.errors import InputError
from omm_core.files.json_input import read_json
from omm_core.session.quantities import THETA
from omm_core.words import image_number

if TYPE_CHECKING:
    from omm_core.part_pose.posterior import PoseStatement
    from omm_runs.recorded_estimator import RecordedEstimate
    from omm_runs.solving import SolvedRun


def solution_lines(solved: "SolvedRun") -> list[str]:
    """Return the lines to print."""
    solution = solved.result.solution
    used = sum(image.used for image in solved.result.images)
    lines = [
        f"{solved.run}: part {solved.result.part_name}, model {solution.model}",
        f"{used} of {len(solved.result.images)} images used, RMS {solution.rms_px:.4f} px, "
        f"sigma0 {solution.sigma0:.3f}, {solution.degrees_of_freedom} degrees of freedom",
        "",
        "in the machine's own coordinates (to align, to hand over)",
        *_table(solution.own, solved.recorded, _truth(solved.run, "theta_own")),
        "",
        "absolute, in an ideal machine frame"
        + (
            "" if solution.geometry_declared else " (geometry not declared: longer errors not seen)"
        ),
        *_table(solution.absolute, None, _truth(solved.run, "theta")),
    ]
    lines += _images(solved)
    lines += ["", *solution.remarks] if solution.remarks else []
    lines += [f"poorly determined: {words}" for words in solution.poor]
    lines += [f"found: {words}" for words in solved.result.findings]
    return lines


def _table(
    told: "PoseStatement", recorded: "RecordedEstimate | None", truth: dict[str, float] | None
) -> list[str]:
    """Return the lines of one statement of the pose, with U that holds 95.45 % of errors."""
    head = f"{'':<9}{'':<6}{'value':>13}{'U (95 %)':>11}"
    if recorded is not None:
        head += f"{'- recorded':>14}"
    if truth is not None:
        head += f"{'- truth':>12}{'of U':>8}"
    lines = [head]
    for k, quantity in enumerate(THETA):
        name, unit, key, scale = quantity.name, quantity.unit, quantity.key, quantity.scale
        value, U = float(told.theta[k]), float(told.expanded_uncertainty[k])
        line = f"{name:<9}{unit:<6}{value * scale:13.4f}{U * scale:11.4f}"
        if recorded is not None:
            line += f"{_difference(value, recorded.theta_si[k], unit):>14}"
        if truth is not None:
            error = value - truth[key]
            ratio = f"{error / U:.2f}" if U > 0.0 else "-"
            line += f"{error * scale:12.4f}{ratio:>8}"
        lines.append(line)
    return lines


def _difference(value: float, recorded_si: float, unit: str) -> str:
    """Return the lines that compare with the live estimate; equal means to the last bit."""
    if math.isnan(recorded_si):
        return "-"
    # As the estimator does for the topic, so that what is equal comes out equal.
    si = value / 1000.0 if unit == "mm" else value
    return "0 (equal)" if si == recorded_si else f"{(si - recorded_si) * 1000.0:.3g}"


def _images(solved: "SolvedRun") -> list[str]:
    refused = [image for image in solved.result.images if not image.used]
    left_out = [o for o in solved.result.observations if not o.used]
    of_used = {image.stamp_ns for image in solved.result.images if image.used}
    run_ns = [image.stamp_ns for image in solved.result.images]
    lines = [
        f"image {image_number(image.stamp_ns, run_ns)} refused: {image.reason}" for image in refused
    ]
    lines += [
        f"target {o.target_id} in image {image_number(o.stamp_ns, run_ns)} not used: {o.reason}"
        for o in left_out
        if o.stamp_ns in of_used
    ]
    return ["", *lines] if lines else []


def _truth(run: Path, which: str) -> dict[str, float] | None:
    """Return the simulated truth (deg, mm) beside the run; None where there is none.

    Of an exact machine there is only one.
    """
    path = (run if run.is_dir() else run.parent) / "truth.json"
    if not path.is_file():
        return None
    try:
        content = read_json(path, "truth")
        theta = content.get(which, content.get("theta", content))
        return {quantity.key: float(theta[quantity.key]) for quantity in THETA}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path} does not hold a truth as expected: {error!r}") from error
