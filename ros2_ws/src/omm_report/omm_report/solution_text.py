"""A solved run as people read it: a table in mm and mm/m, and what became of the images."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from omm_core.errors import InputError
from omm_core.files.json_input import read_json
from omm_core.session.quantities import THETA

if TYPE_CHECKING:
    from omm_runs.solving import SolvedRun

COVERAGE = 2.0


def solution_lines(solved: "SolvedRun") -> list[str]:
    """The lines to print."""
    solution = solved.result.solution
    truth = _truth(solved.run)
    head = f"{'':<9}{'':<6}{'value':>13}{'U (k=2)':>11}"
    if solved.recorded is not None:
        head += f"{'- recorded':>14}"
    if truth is not None:
        head += f"{'- truth':>12}{'in sigma':>10}"
    used = sum(image.used for image in solved.result.images)
    lines = [
        f"{solved.run}: part {solved.result.part_name}, model {solution.model}",
        f"{used} of {len(solved.result.images)} images used, RMS {solution.rms_px:.4f} px, "
        f"sigma0 {solution.sigma0:.3f}, {solution.degrees_of_freedom} degrees of freedom",
        "",
        head,
    ]
    for k, quantity in enumerate(THETA):
        name, unit, key, scale = quantity.name, quantity.unit, quantity.key, quantity.scale
        value = float(solution.theta[k])
        sigma = math.sqrt(max(float(solution.covariance[k, k]), 0.0))
        line = f"{name:<9}{unit:<6}{value * scale:13.4f}{COVERAGE * sigma * scale:11.4f}"
        if solved.recorded is not None:
            line += f"{_difference(value, solved.recorded.theta_si[k], unit):>14}"
        if truth is not None:
            error = value - truth[key]
            ratio = f"{error / sigma:.2f}" if sigma > 0.0 else "-"
            line += f"{error * scale:12.4f}{ratio:>10}"
        lines.append(line)
    lines += _images(solved)
    lines += [f"poorly determined: {words}" for words in solution.poor]
    lines += [f"found: {words}" for words in solved.result.findings]
    return lines


def _difference(value: float, recorded_si: float, unit: str) -> str:
    """Against the live estimate; equal means to the last bit."""
    if math.isnan(recorded_si):
        return "-"
    # As the estimator does for the topic, so that what is equal comes out equal.
    si = value / 1000.0 if unit == "mm" else value
    return "0 (equal)" if si == recorded_si else f"{(si - recorded_si) * 1000.0:.3g}"


def _images(solved: "SolvedRun") -> list[str]:
    refused = [image for image in solved.result.images if not image.used]
    left_out = [o for o in solved.result.observations if not o.used]
    of_used = {image.stamp_ns for image in solved.result.images if image.used}
    lines = [f"image {image.stamp_ns} refused: {image.reason}" for image in refused]
    lines += [
        f"target {o.target_id} in image {o.stamp_ns} not used: {o.reason}"
        for o in left_out
        if o.stamp_ns in of_used
    ]
    return ["", *lines] if lines else []


def _truth(run: Path) -> dict[str, float] | None:
    """The simulated truth in the machine's own coordinates, where it lies beside the run."""
    path = (run if run.is_dir() else run.parent) / "truth.json"
    if not path.is_file():
        return None
    try:
        content = read_json(path, "truth")
        theta = content.get("theta_own", content.get("theta", content))
        return {quantity.key: float(theta[quantity.key]) for quantity in THETA}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path} does not tell a truth as expected: {error!r}") from error
