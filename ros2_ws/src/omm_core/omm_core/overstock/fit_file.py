"""Read fit.yaml: points, CAD, allowances, start (contract.md, "Files")."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]


_KEYS = (
    "points", "cad", "target_thickness_mm", "criterion", "minimum_overstock_mm", "groups", "pairs"
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceGroup:
    """Faces (numbers from 1, as ``--faces`` lists them) with an allowance of their own."""

    name: str
    faces: tuple[int, ...]
    minimum_overstock_mm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class FitFile:
    """What a fit is asked for; lengths in mm, pairs by name of the point."""

    points: Path
    cad: Path
    target_thickness_mm: float
    criterion: str
    minimum_overstock_mm: float
    groups: tuple[FaceGroup, ...]
    pairs: dict[str, Array]


def load_fit_file(path: Path) -> FitFile:
    """Read fit.yaml; a folder stands for the fit.yaml in it.

    Raises
    ------
    InputError
        Where a key is missing or bad.
    """
    path = path / "fit.yaml" if path.is_dir() else path
    root = read_yaml(path, "fit file")
    root.warn_unknown(*_KEYS)
    criterion = root.text("criterion") if "criterion" in root else "even"
    if criterion not in ("even", "least_squares"):
        raise InputError(f"{path}: expected criterion even or least_squares, got '{criterion}'.")
    least = root.number("minimum_overstock_mm") if "minimum_overstock_mm" in root else 0.0
    return FitFile(
        points=path.parent / root.text("points"),
        cad=path.parent / root.text("cad"),
        target_thickness_mm=root.number("target_thickness_mm", above=-1e-12),
        criterion=criterion,
        minimum_overstock_mm=least,
        groups=tuple(_group(entry, least) for entry in _entries(root, "groups")),
        pairs={
            entry.text("point"): entry.numbers("xyz_mm", 3) for entry in _entries(root, "pairs")
        },
    )


def _entries(root: YamlSection, key: str) -> list[YamlSection]:
    if key not in root:
        return []
    values = root.get(key)
    if not isinstance(values, list):
        raise InputError(f"{root.where}: expected a list for '{key}'.")
    return [YamlSection(v, f"{root.where}: {key}, entry {n}") for n, v in enumerate(values, 1)]


def _group(entry: YamlSection, least: float) -> FaceGroup:
    for key in set(entry.values) - {"name", "faces", "minimum_overstock_mm"}:
        raise InputError(
            f"{entry.where}: the key '{key}' is not known here; known: name, faces"
            " (numbers from --faces), minimum_overstock_mm."
        )
    key = "minimum_overstock_mm"
    return FaceGroup(
        name=entry.text("name"),
        faces=tuple(int(n) for n in entry.numbers("faces")),
        minimum_overstock_mm=entry.number(key) if key in entry else least,
    )
