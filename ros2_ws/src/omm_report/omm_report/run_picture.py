"""The picture of a solved run: its images, targets and enlarged residuals."""

import math
from pathlib import Path

import numpy as np

from omm_report.picture import DrawnImage, DrawnTarget, draw_run, save_picture
from omm_runs.solving import SolvedRun

_LONGEST_RESIDUAL_PX = 150.0


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
