"""A measurement's result for people: the table of an estimate, the picture of a run."""

import math
from pathlib import Path

import numpy as np
from omm_interfaces.msg import PartEstimate
from rich.table import Table

from omm_bringup.picture import DrawnImage, DrawnTarget, draw_run, save_picture
from omm_recorder.solving import SolvedRun

COVERAGE = 2.0
_ROWS = (
    ("α", "mm/m"),
    ("β", "mm/m"),
    ("γ", "mm/m"),
    ("x", "mm"),
    ("y", "mm"),
    ("z", "mm"),
    ("γ_s", "mm/m"),
)
_MILLI = 1000.0  # from m to mm, and from rad to mm/m
_LONGEST_RESIDUAL_PX = 150.0


def estimate_table(estimate: PartEstimate) -> Table:
    """The parameters of a live estimate with their expanded uncertainties."""
    table = Table(title=f"{estimate.part}, {estimate.model}", title_justify="left")
    table.add_column("parameter")
    table.add_column("unit")
    table.add_column("value", justify="right")
    table.add_column("U (k=2)", justify="right")
    for i, (name, unit) in enumerate(_ROWS):
        sigma = math.sqrt(max(0.0, estimate.covariance[8 * i])) if estimate.determined else math.nan
        value = estimate.theta[i]
        table.add_row(name, unit, f"{value * _MILLI:.4f}", f"{COVERAGE * sigma * _MILLI:.4f}")
    return table


def save_run_picture(solved: SolvedRun, path: Path) -> Path:
    """Draw all images with targets, numbers and enlarged residuals; returns the path."""
    outcomes = {image.stamp_ns: image for image in solved.result.images}
    drawn = []
    for number, (stamp_ns, pixels) in enumerate(solved.images(), start=1):
        outcome = outcomes.get(stamp_ns)
        used = outcome is not None and outcome.used
        reason = "" if used or outcome is None else f": {outcome.reason}"
        targets = tuple(
            DrawnTarget(
                target_id=o.target_id,
                center_px=o.center_px,
                residual_px=o.residual_px if np.all(np.isfinite(o.residual_px)) else (0.0, 0.0),
                used=o.used,
            )
            for o in solved.result.observations
            if o.stamp_ns == stamp_ns
        )
        drawn.append(
            DrawnImage(pixels=pixels, title=f"image {number}{reason}", used=used, targets=targets)
        )
    residuals = [math.hypot(*target.residual_px) for image in drawn for target in image.targets]
    longest = max(residuals, default=0.0)
    scale = _LONGEST_RESIDUAL_PX / longest if longest > 0 else 1.0
    save_picture(path, draw_run(drawn, scale))
    return path
