"""The pictures of a survey as PNG files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omm_core.errors import InputError
from omm_core.files.output import write_whole
from omm_report.budget_figures import figure_png
from omm_report.survey_report import (
    acceptance_figure,
    network_figure,
    per_photo_figure,
    rays_figure,
    residual_figure,
)


def write_pictures(result: dict[str, Any], folder: Path) -> None:
    """Write network, residuals, rays of each target and, if there are any, lengths.

    Parameters
    ----------
    result : dict
        In the form of ``survey --json``.
    folder : Path
        Is made where it is missing.

    Raises
    ------
    InputError
        Where it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"Cannot make the folder {folder}: {error.strerror}.") from error
    figures = {"network": network_figure(result), "rays": rays_figure(result)}
    if result.get("observations"):
        figures["residuals"] = residual_figure(result)
        figures["residuals_by_photograph"] = per_photo_figure(result)
    if result.get("acceptance"):
        figures["lengths"] = acceptance_figure(result["acceptance"])
    for name, figure in figures.items():
        write_whole(folder / f"{name}.png", figure_png(figure))
