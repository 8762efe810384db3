"""campaign.yaml: which run belongs to which clamping (contract.md, "Files").

Besides, it may name ``part``, ``calibration``, ``tolerance_mm`` (full width, for x, y, z),
``tolerance_mm_per_m`` (for the angles) and ``reference`` (true values, by the names of θ).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection, read_yaml

THETA = ("alpha_rad", "beta_rad", "gamma_rad", "x_mm", "y_mm", "z_mm", "gamma_s_rad")
_FIELDS = ("runs", "part", "calibration", "tolerance_mm", "tolerance_mm_per_m", "reference")


@dataclass(frozen=True, kw_only=True)
class CampaignRun:
    """One run of a campaign: which clamping it belongs to, and the how manieth in it."""

    run: Path
    clamping: int
    repeat: int


@dataclass(frozen=True, kw_only=True)
class CampaignFile:
    """What campaign.yaml says; tolerances are full widths by the names of θ."""

    path: Path
    runs: tuple[CampaignRun, ...]
    part: Path | None = None
    calibration: Path | None = None
    tolerances: Mapping[str, float] = field(default_factory=dict)
    reference: Mapping[str, float] = field(default_factory=dict)


def load_campaign_file(path: Path) -> CampaignFile:
    """Read campaign.yaml, or the one in a folder.

    Raises
    ------
    InputError
        Where the file is missing or malformed, or two runs are the same repeat of a clamping.
    """
    path = path / "campaign.yaml" if path.is_dir() else path
    root = read_yaml(path, "campaign file")
    root.refuse_unknown(*_FIELDS)
    entries = root.get("runs")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{root.where}: expected a list of runs with at least one entry.")
    runs = tuple(
        _run(YamlSection(entry, f"{root.where}: runs, entry {number}"), path.parent)
        for number, entry in enumerate(entries, start=1)
    )
    places = [f"clamping {run.clamping}, repeat {run.repeat}" for run in runs]
    for what, each in (("clamping and repeat", places), ("run", [str(run.run) for run in runs])):
        twice = sorted(one for one, number in Counter(each).items() if number > 1)[:10]
        if twice:
            raise InputError(f"{root.where}: expected each {what} once, got {twice[0]} twice.")
    reference = root.section("reference") if "reference" in root else None
    if reference is not None:
        reference.refuse_unknown(*THETA)
    return CampaignFile(
        path=path,
        runs=runs,
        part=path.parent / root.text("part") if "part" in root else None,
        calibration=path.parent / root.text("calibration") if "calibration" in root else None,
        tolerances=_tolerances(root),
        reference=(
            {name: reference.number(name) for name in THETA if name in reference}
            if reference
            else {}
        ),
    )


def _run(entry: YamlSection, folder: Path) -> CampaignRun:
    entry.refuse_unknown("run", "clamping", "repeat")
    return CampaignRun(
        run=folder / entry.text("run"),
        clamping=entry.integer("clamping"),
        repeat=entry.integer("repeat") if "repeat" in entry else 1,
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
