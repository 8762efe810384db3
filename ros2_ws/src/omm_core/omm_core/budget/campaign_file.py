"""campaign.yaml: which run belongs to which clamping (contract.md, "Files").

Besides, it may name ``part``, ``calibration``, ``tolerance_mm`` (full width, for x, y, z),
``tolerance_mm_per_m`` (for the angles) and ``reference`` (true values, by the names of θ).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from omm_core.errors import InputError
from omm_core.files.declared import Reader, expect_once, file, integer, read_each, read_section
from omm_core.files.yaml_input import YamlSection, read_yaml

THETA = ("alpha_rad", "beta_rad", "gamma_rad", "x_mm", "y_mm", "z_mm", "gamma_s_rad")


@dataclass(frozen=True, kw_only=True)
class CampaignRun:
    """One run of a campaign: which clamping it belongs to, and its number within it."""

    run: Annotated[Path, file()]
    clamping: Annotated[int, integer()]
    repeat: Annotated[int, integer()] = 1


def _runs(root: YamlSection, key: str) -> tuple[CampaignRun, ...]:
    runs = read_each(CampaignRun, root, key, once="run")
    if not runs:
        raise InputError(f"{root.where}: expected a list of runs with at least one entry.")
    places = [f"clamping {run.clamping}, repeat {run.repeat}" for run in runs]
    expect_once(places, f"{root.where}: {key}", "clamping and repeat")
    return runs


def _reference(root: YamlSection, key: str) -> dict[str, float]:
    section = root.section(key)
    section.check_keys(*THETA)
    return {name: section.number(name) for name in THETA if name in section}


@dataclass(frozen=True, kw_only=True)
class CampaignFile:
    """What campaign.yaml says; tolerances are full widths by the names of θ."""

    path: Path
    runs: Annotated[tuple[CampaignRun, ...], Reader(_runs)]
    part: Annotated[Path | None, file()] = None
    calibration: Annotated[Path | None, file()] = None
    tolerances: Mapping[str, float] = field(default_factory=dict)
    reference: Annotated[Mapping[str, float], Reader(_reference)] = field(default_factory=dict)


def load_campaign_file(path: Path) -> CampaignFile:
    """Read campaign.yaml, or the one in a folder.

    Raises
    ------
    InputError
        Where the file is missing or malformed, or two runs are the same repeat of a clamping.
    """
    path = path / "campaign.yaml" if path.is_dir() else path
    root = read_yaml(path, "campaign file")
    return read_section(
        CampaignFile,
        root,
        also=("tolerance_mm", "tolerance_mm_per_m"),
        path=path,
        tolerances=_tolerances(root),
    )


def _tolerances(root: YamlSection) -> dict[str, float]:
    found: dict[str, float] = {}
    if "tolerance_mm" in root:
        width = root.number("tolerance_mm", above=0.0)
        found |= dict.fromkeys(("x_mm", "y_mm", "z_mm"), width)
    if "tolerance_mm_per_m" in root:
        width = root.number("tolerance_mm_per_m", above=0.0) / 1e3
        found |= dict.fromkeys(("alpha_rad", "beta_rad", "gamma_rad"), width)
    return found
