"""The picture of a solved run: its images, targets and enlarged residuals."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_report.picture import DrawnImage, DrawnTarget, draw_run, save_picture
from omm_runs.solving import SolvedRun

_LONGEST_RESIDUAL_PX = 150.0


def save_run_picture(solved: SolvedRun, path: Path) -> Path:
    """Draw all images with targets, numbers and enlarged residuals; returns the path."""
    drawn, scale = _drawn(solved, "image {n} of {of}", reasons=True)
    save_picture(path, draw_run(drawn, scale))
    return path


def run_picture(
    solved: SolvedRun, title: str, *, columns: int
) -> tuple[NDArray[np.uint8], float] | None:
    """Return all images for print, and how many times residuals are enlarged.

    Parameters
    ----------
    title : str
        Below each image; ``{n}`` and ``{of}`` stand for its number and how many there are.
        Letters of ASCII only.
    columns : int
        Images side by side.
    """
    drawn, scale = _drawn(solved, title, reasons=False)
    if not drawn:
        return None
    return draw_run(drawn, scale, columns=columns, text_scale=1.0, caption=False), scale


def _drawn(solved: SolvedRun, title: str, *, reasons: bool) -> tuple[list[DrawnImage], float]:
    """Return the images to draw, and how many times residuals are enlarged."""
    outcomes = {image.stamp_ns: image for image in solved.result.images}
    numbers = {stamp_ns: at for at, stamp_ns in enumerate(outcomes, start=1)}
    drawn = []
    for stamp_ns, pixels in solved.images():
        outcome = outcomes.get(stamp_ns)
        used = outcome is not None and outcome.used
        reason = "" if used or outcome is None or not reasons else f": {outcome.reason}"
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
        number, of = str(numbers.get(stamp_ns, "?")), str(len(numbers))
        named = title.replace("{n}", number).replace("{of}", of) + reason
        drawn.append(DrawnImage(pixels=pixels, title=named, used=used, targets=targets))
    residuals = [math.hypot(*target.residual_px) for image in drawn for target in image.targets]
    longest = max(residuals, default=0.0)
    return drawn, _LONGEST_RESIDUAL_PX / longest if longest > 0 else 1.0
