"""Read fit.yaml: points, CAD, allowances, start (contract.md, "Files"; docs/fit.md)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.declared import (
    Reader,
    choice,
    direction,
    expect_once,
    file,
    integer,
    number,
    numbers,
    read_each,
    read_section,
    text,
)
from omm_core.files.outside import Source, file_in
from omm_core.files.part import load_part
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]
_LEAST = "minimum_overstock_mm"
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}


def _faces(section: YamlSection, key: str) -> tuple[int, ...]:
    given = section.numbers(key)
    if (given != given.round()).any():
        raise InputError(f"{section.where}: expected whole numbers of faces, got {given}.")
    return tuple(int(n) for n in given)


def _names(section: YamlSection, key: str) -> tuple[str, ...]:
    given = section.get(key)
    if not isinstance(given, list) or any(isinstance(v, (list, dict)) for v in given):
        raise InputError(f"{section.where}: expected a list of names for '{key}'.")
    return tuple(str(v) for v in given)


def _two_names(section: YamlSection, key: str) -> tuple[str, str]:
    given = _names(section, key)
    if len(given) != 2:
        raise InputError(f"{section.where}: expected the names of two groups for '{key}'.")
    return given[0], given[1]


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceGroup:
    """Faces with limits of their own, mm; None where there is none.

    Chosen by number (from 1, as ``--faces`` lists them), or by all that is given of kind, normal,
    offset, radius, colour and label. ``minimum_mm`` None: the faces are not milled.
    """

    name: Annotated[str, text()]
    faces: Annotated[tuple[int, ...], Reader(_faces)] = ()
    kind: Annotated[str | None, text()] = None
    normal: Annotated[Array | None, direction()] = None
    offset_mm: Annotated[float | None, number()] = None
    radius_mm: Annotated[float | None, number()] = None
    colour: Annotated[str | None, text()] = None
    label: Annotated[str | None, text()] = None
    minimum_mm: Annotated[float | None, number(), "minimum_overstock_mm"] = 0.0
    maximum_mm: Annotated[float | None, number(), "maximum_overstock_mm"] = None
    datum_mm: Annotated[float | None, number(), "datum_overstock_mm"] = None

    @property
    def chooses(self) -> bool:
        """Return whether faces are chosen by what they are."""
        given = (self.kind, self.offset_mm, self.radius_mm, self.colour, self.label)
        return self.normal is not None or any(value is not None for value in given)


@dataclass(frozen=True, kw_only=True, eq=False)
class Tolerance:
    """Mean overstock of the first group minus the second's: between these, mm."""

    groups: Annotated[tuple[str, str], Reader(_two_names, list)]
    low_mm: Annotated[float, number()]
    high_mm: Annotated[float, number()]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pair:
    point: Annotated[str, text()]
    xyz_mm: Annotated[Array, numbers(3)]


@dataclass(frozen=True, kw_only=True, eq=False)
class _NominalTarget:
    id: Annotated[int, integer(minimum=1)]
    xyz_mm: Annotated[Array, numbers(3)]


def _pairs(root: YamlSection, key: str) -> dict[str, Array]:
    return {pair.point: pair.xyz_mm for pair in read_each(_Pair, root, key, once="point")}


def _nominal_targets(root: YamlSection, key: str) -> dict[int, Array]:
    """Read where coded targets should be: the name of a part.yaml, or a list of id and xyz_mm."""
    if isinstance(root.get(key), str):
        part = load_part(root.folder / root.text(key))
        return {target.id: target.xyz_mm for target in part.targets}
    return {told.id: told.xyz_mm for told in read_each(_NominalTarget, root, key, once="id")}


def _groups(root: YamlSection, key: str) -> tuple[FaceGroup, ...]:
    least = root.number(_LEAST) if _LEAST in root else 0.0
    groups = tuple(_group(entry, least) for entry in root.sections(key))
    expect_once([group.name for group in groups], f"{root.where}: {key}")
    return groups


def _group(entry: YamlSection, least: float) -> FaceGroup:
    """Read a group: its minimum is that of all where it has none, and none where it is null."""
    given: dict[str, Any] = {}
    if _LEAST not in entry:
        given["minimum_mm"] = None if _LEAST in entry.values else least
    group = read_section(FaceGroup, entry, **given)
    low, high = group.minimum_mm, group.maximum_mm
    if low is not None and high is not None and high < low:
        raise InputError(
            f"{entry.where}: expected a maximum above the minimum, got {high} < {low}."
        )
    return group


def _tolerances(root: YamlSection, key: str) -> tuple[Tolerance, ...]:
    found = read_each(Tolerance, root, key)
    for one in found:
        if one.low_mm > one.high_mm:
            raise InputError(
                f"{root.where}: {key}: expected low_mm <= high_mm, got"
                f" {one.low_mm} > {one.high_mm}."
            )
    return found


def _unit(root: YamlSection, key: str) -> float:
    return UNITS_MM[str(choice(*UNITS_MM).read(root, key))]


@dataclass(frozen=True, kw_only=True, eq=False)
class FitFile:
    """What a fit is asked for; lengths in mm.

    ``pairs``: about where on the CAD a point is, by its name; ``nominal_targets``: where coded
    targets should be, by their number; ``placement``: which of several that fit as well, from 1.
    ``keep`` and ``leave_out`` name points whatever else is thought of them.
    """

    points: Annotated[Path, file()]
    cad: Annotated[Path, file()]
    target_thickness_mm: Annotated[float, number(least=0.0)]
    criterion: Annotated[str, choice("even", "least_squares")] = "even"
    minimum_overstock_mm: Annotated[float, number()] = 0.0
    cad_unit_mm: Annotated[float, Reader(_unit), "cad_unit"] = 1.0
    groups: Annotated[tuple[FaceGroup, ...], Reader(_groups)] = ()
    tolerances: Annotated[tuple[Tolerance, ...], Reader(_tolerances)] = ()
    pairs: Annotated[dict[str, Array], Reader(_pairs)] = field(default_factory=dict)
    nominal_targets: Annotated[dict[int, Array], Reader(_nominal_targets)] = field(
        default_factory=dict
    )
    placement: Annotated[int | None, integer(minimum=1)] = None
    keep: Annotated[tuple[str, ...], Reader(_names, list)] = ()
    leave_out: Annotated[tuple[str, ...], Reader(_names, list)] = ()


def load_fit_file(path: Source) -> FitFile:
    """Read fit.yaml; a folder stands for the fit.yaml in it.

    Raises
    ------
    InputError
        Where a key is missing, bad or not known.
    """
    return read_section(FitFile, read_yaml(file_in(path, "fit.yaml"), "fit file"))
