"""Read fit.yaml: points, CAD, allowances, start (contract.md, "Files"; docs/fit.md)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.part import load_part
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
_ROOT = (
    "points", "cad", "cad_unit", "target_thickness_mm", "criterion", "minimum_overstock_mm",
    "groups", "tolerances", "pairs", "nominal_targets", "placement", "keep", "leave_out",
)  # fmt: skip
_GROUP = (
    "name", "faces", "kind", "normal", "offset_mm", "radius_mm", "colour", "label",
    "minimum_overstock_mm", "maximum_overstock_mm", "datum_overstock_mm",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceGroup:
    """Faces with limits of their own, mm; None where there is none.

    Chosen by number (from 1, as ``--faces`` lists them), or by all that is given of kind, normal,
    offset, radius, colour and label. ``minimum_mm`` None: the faces are not milled.
    """

    name: str
    faces: tuple[int, ...] = ()
    kind: str | None = None
    normal: Array | None = None
    offset_mm: float | None = None
    radius_mm: float | None = None
    colour: str | None = None
    label: str | None = None
    minimum_mm: float | None = 0.0
    maximum_mm: float | None = None
    datum_mm: float | None = None

    @property
    def chooses(self) -> bool:
        """Return whether faces are chosen by what they are."""
        given = (self.kind, self.offset_mm, self.radius_mm, self.colour, self.label)
        return self.normal is not None or any(value is not None for value in given)


@dataclass(frozen=True, kw_only=True, eq=False)
class Tolerance:
    """Mean overstock of the first group minus the second's: between these, mm."""

    groups: tuple[str, str]
    low_mm: float
    high_mm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class FitFile:
    """What a fit is asked for; lengths in mm.

    ``pairs``: about where on the CAD a point is, by its name; ``nominal_targets``: where coded
    targets should be, by their number; ``placement``: which of several that fit as well, from 1.
    ``keep`` and ``leave_out`` name points whatever else is thought of them.
    """

    points: Path
    cad: Path
    target_thickness_mm: float
    criterion: str = "even"
    minimum_overstock_mm: float = 0.0
    cad_unit_mm: float = 1.0
    groups: tuple[FaceGroup, ...] = ()
    tolerances: tuple[Tolerance, ...] = ()
    pairs: dict[str, Array] = field(default_factory=dict)
    nominal_targets: dict[int, Array] = field(default_factory=dict)
    placement: int | None = None
    keep: tuple[str, ...] = ()
    leave_out: tuple[str, ...] = ()


def load_fit_file(path: Path) -> FitFile:
    """Read fit.yaml; a folder stands for the fit.yaml in it.

    Raises
    ------
    InputError
        Where a key is missing, bad or not known.
    """
    path = path / "fit.yaml" if path.is_dir() else path
    root = read_yaml(path, "fit file")
    root.refuse_unknown(*_ROOT)
    least = root.number("minimum_overstock_mm") if "minimum_overstock_mm" in root else 0.0
    return FitFile(
        points=path.parent / root.text("points"),
        cad=path.parent / root.text("cad"),
        cad_unit_mm=UNITS_MM[_choice(root, "cad_unit", tuple(UNITS_MM))],
        target_thickness_mm=root.number("target_thickness_mm", above=-1e-12),
        criterion=_choice(root, "criterion", ("even", "least_squares")),
        minimum_overstock_mm=least,
        groups=_groups(root, least),
        tolerances=tuple(_tolerance(entry) for entry in _entries(root, "tolerances")),
        pairs=_pairs(root),
        nominal_targets=_nominal(root, path.parent),
        placement=root.integer("placement", minimum=1) if "placement" in root else None,
        keep=_names(root, "keep"),
        leave_out=_names(root, "leave_out"),
    )


def _known(section: YamlSection, keys: tuple[str, ...]) -> None:
    for key in section.values:
        if key not in keys:
            raise InputError(
                f"{section.where}: the key '{key}' is not known here; known: {', '.join(keys)}."
            )


def _choice(root: YamlSection, key: str, known: tuple[str, ...]) -> str:
    value = root.text(key) if key in root else known[0]
    if value not in known:
        raise InputError(
            f"{root.where}: expected '{key}' out of {', '.join(known)}, got '{value}'."
        )
    return value


def _entries(root: YamlSection, key: str) -> list[YamlSection]:
    if key not in root:
        return []
    values = root.get(key)
    if not isinstance(values, list):
        raise InputError(f"{root.where}: expected a list for '{key}'.")
    return [YamlSection(v, f"{root.where}: {key}, entry {n}") for n, v in enumerate(values, 1)]


def _names(root: YamlSection, key: str) -> tuple[str, ...]:
    values = root.get(key) if key in root else []
    if not isinstance(values, list) or any(isinstance(v, (list, dict)) for v in values):
        raise InputError(f"{root.where}: expected a list of points' names for '{key}'.")
    return tuple(str(v) for v in values)


def _pairs(root: YamlSection) -> dict[str, Array]:
    pairs: dict[str, Array] = {}
    for entry in _entries(root, "pairs"):
        name = entry.text("point")
        if name in pairs:
            raise InputError(f"{entry.where}: expected each point once, got '{name}' twice.")
        pairs[name] = entry.numbers("xyz_mm", 3)
    return pairs


def _nominal(root: YamlSection, folder: Path) -> dict[int, Array]:
    """Read where coded targets should be: the name of a part.yaml, or a list of id and xyz_mm."""
    if "nominal_targets" not in root:
        return {}
    if isinstance(root.get("nominal_targets"), str):
        part = load_part(folder / root.text("nominal_targets"))
        return {target.id: target.xyz_mm for target in part.targets}
    entries = _entries(root, "nominal_targets")
    return {e.integer("id", minimum=1): e.numbers("xyz_mm", 3) for e in entries}


def _groups(root: YamlSection, least: float) -> tuple[FaceGroup, ...]:
    groups = tuple(_group(entry, least) for entry in _entries(root, "groups"))
    names = [group.name for group in groups]
    twice = sorted(name for name, number in Counter(names).items() if number > 1)[:10]
    if twice:
        raise InputError(f"{root.where}: groups: expected each name once, got {twice} again.")
    return groups


def _group(entry: YamlSection, least: float) -> FaceGroup:
    _known(entry, _GROUP)
    minimum: float | None = least
    if "minimum_overstock_mm" in entry:
        minimum = entry.number("minimum_overstock_mm")
    elif "minimum_overstock_mm" in entry.values:
        minimum = None
    maximum = _optional(entry, "maximum_overstock_mm")
    if maximum is not None and minimum is not None and maximum < minimum:
        raise InputError(
            f"{entry.where}: expected a maximum above the minimum, got {maximum} < {minimum}."
        )
    normal = entry.numbers("normal", 3) if "normal" in entry else None
    if normal is not None:
        length = float(np.linalg.norm(normal))
        if length < 1e-6:
            raise InputError(f"{entry.where}: expected a normal with a direction, got {normal}.")
        normal = normal / length
    numbers = entry.numbers("faces") if "faces" in entry else np.empty(0)
    if (numbers != numbers.round()).any():
        raise InputError(f"{entry.where}: expected whole numbers of faces, got {numbers}.")
    return FaceGroup(
        name=entry.text("name"),
        faces=tuple(int(n) for n in numbers),
        kind=entry.text("kind") if "kind" in entry else None,
        normal=normal,
        offset_mm=_optional(entry, "offset_mm"),
        radius_mm=_optional(entry, "radius_mm"),
        colour=entry.text("colour") if "colour" in entry else None,
        label=entry.text("label") if "label" in entry else None,
        minimum_mm=minimum,
        maximum_mm=maximum,
        datum_mm=_optional(entry, "datum_overstock_mm"),
    )


def _tolerance(entry: YamlSection) -> Tolerance:
    _known(entry, ("groups", "low_mm", "high_mm"))
    names = entry.get("groups")
    if not isinstance(names, list) or len(names) != 2:
        raise InputError(f"{entry.where}: expected the names of two groups for 'groups'.")
    low, high = entry.number("low_mm"), entry.number("high_mm")
    if low > high:
        raise InputError(f"{entry.where}: expected low_mm <= high_mm, got {low} > {high}.")
    return Tolerance(groups=(str(names[0]), str(names[1])), low_mm=low, high_mm=high)


def _optional(entry: YamlSection, key: str) -> float | None:
    return entry.number(key) if key in entry else None
