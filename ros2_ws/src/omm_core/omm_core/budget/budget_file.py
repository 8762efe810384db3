"""budget.yaml: the contributors of an uncertainty budget (contract.md, "Files")."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.distributions import Distribution
from omm_core.budget.spread_reading import SPREAD_KEYS, read_sigma, read_spread
from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]

# What a length's unit is in mm; of any other unit the sensitivity says how many mm it makes.
LENGTHS_MM = {"m": 1e3, "mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "nm": 1e-6}
_ROOT = ("part", "points", "u_ip", "u_it", "u_out", "machine", "contributors", "coverage_factor",
         "coverage_probability", "tolerance_mm", "tool_mm")  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class NamedPoint:
    """A point of the part, part frame; its deviation from nominal (mm, three axes) where told."""

    name: str
    xyz_mm: Array
    deviation_mm: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class InPart:
    """Where u_ip comes from; several may be there."""

    run: Path | None = None
    campaign: Path | None = None
    sigma_mm: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Expansion:
    """What u_it is made of: about the part's origin.

    Attributes
    ----------
    per_K : float
        Expansion of the part; ``per_K_spread`` is how well it is known.
    mean_K : float
        Deviation from the temperature at which the part was surveyed, not corrected for.
    temperature : Distribution
        Of that temperature's uncertainty, K.
    gradient : Distribution or None
        Of a temperature that grows linearly along the part, K per m: it bends and stretches.
    sigma_mm : (3,) array or None
        u_it as it is, at each point, instead of all that.
    """

    per_K: float = 0.0
    per_K_spread: Distribution | None = None
    mean_K: float = 0.0
    temperature: Distribution | None = None
    gradient: Distribution | None = None
    sigma_mm: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class OutOfMachine:
    """Where u_out comes from: a survey, or a length measuring error (VDI/VDE 2634-1)."""

    points: Path | None = None
    constant_mm: float = 0.0
    per_metre_mm: float = 0.0
    sigma_mm: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Contributor:
    """Anything else: ``sensitivity`` (3,) makes mm of it along machine X Y Z.

    ``correlation`` is by name with other contributors, or with u_ip, u_it, u_out, u_machine.
    """

    name: str
    unit: str
    distribution: Distribution
    sensitivity: Array
    correlation: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class BudgetFile:
    """What budget.yaml says; ``points`` is None where the box of the part is meant."""

    path: Path
    part: Path
    points: tuple[NamedPoint, ...] | None
    u_ip: InPart | None
    u_it: Expansion | None
    u_out: OutOfMachine | None
    machine: Path | None
    tool_mm: Array
    contributors: tuple[Contributor, ...]
    coverage_factor: float | None
    coverage_probability: float | None
    tolerance_mm: float | None


def load_budget_file(path: Path) -> BudgetFile:
    """Read budget.yaml, or the one in a folder; paths in it are relative to it.

    Raises
    ------
    InputError
        Where the file is missing or malformed, or names no contributor at all.
    """
    path = path / "budget.yaml" if path.is_dir() else path
    root = read_yaml(path, "budget file")
    root.warn_unknown(*_ROOT)
    factor = root.number("coverage_factor", above=0.0) if "coverage_factor" in root else None
    probability = _probability(root)
    if factor is not None and probability is not None:
        raise InputError(
            f"{root.where}: expected coverage_factor or coverage_probability, got both."
        )
    file = BudgetFile(
        path=path,
        part=path.parent / root.text("part"),
        points=_points(root),
        u_ip=_in_part(root.section("u_ip"), path.parent) if "u_ip" in root else None,
        u_it=_expansion(root.section("u_it")) if "u_it" in root else None,
        u_out=_out_of_machine(root.section("u_out"), path.parent) if "u_out" in root else None,
        machine=path.parent / root.text("machine") if "machine" in root else None,
        tool_mm=root.numbers("tool_mm", 3) if "tool_mm" in root else np.zeros(3),
        contributors=_contributors(root),
        coverage_factor=2.0 if factor is None and probability is None else factor,
        coverage_probability=probability,
        tolerance_mm=root.number("tolerance_mm", above=0.0) if "tolerance_mm" in root else None,
    )
    if not (file.u_ip or file.u_it or file.u_out or file.machine or file.contributors):
        raise InputError(
            f"{root.where}: expected at least one of u_ip, u_it, u_out, machine, contributors."
        )
    return file


def _points(root: YamlSection) -> tuple[NamedPoint, ...] | None:
    given = root.values.get("points", "box")
    if given is None or given == "box":
        return None
    if not isinstance(given, list) or not given:
        raise InputError(f"{root.where}: expected 'box' or a list for 'points', got {given!r}.")
    entries = [
        YamlSection(entry, f"{root.where}: points, entry {number}")
        for number, entry in enumerate(given, start=1)
    ]
    points = tuple(
        NamedPoint(
            name=entry.text("name"),
            xyz_mm=entry.numbers("xyz_mm", 3),
            deviation_mm=entry.numbers("deviation_mm", 3) if "deviation_mm" in entry else None,
        )
        for entry in entries
    )
    _once([point.name for point in points], f"{root.where}: points")
    return points


def _in_part(section: YamlSection, folder: Path) -> InPart:
    section.warn_unknown("run", "campaign", "sigma_mm")
    if not any(key in section for key in ("run", "campaign", "sigma_mm")):
        raise InputError(f"{section.where}: expected run, campaign or sigma_mm.")
    return InPart(
        run=folder / section.text("run") if "run" in section else None,
        campaign=folder / section.text("campaign") if "campaign" in section else None,
        sigma_mm=read_sigma(section) if "sigma_mm" in section else None,
    )


def _expansion(section: YamlSection) -> Expansion:
    section.warn_unknown("expansion_per_K", "temperature_K", "gradient_K_per_m", "sigma_mm")
    if "sigma_mm" in section:
        return Expansion(sigma_mm=read_sigma(section))
    spread, value = None, section.get("expansion_per_K")
    if isinstance(value, dict):
        own = section.section("expansion_per_K")
        per_K = own.number("value")
        if any(key in own for key in SPREAD_KEYS):
            spread = read_spread(own, ("value",))
    else:
        per_K = section.number("expansion_per_K")
    temperature = section.section("temperature_K") if "temperature_K" in section else None
    gradient = "gradient_K_per_m"
    return Expansion(
        per_K=per_K,
        per_K_spread=spread,
        mean_K=temperature.number("mean") if temperature and "mean" in temperature else 0.0,
        temperature=read_spread(temperature, ("mean",)) if temperature else None,
        gradient=read_spread(section.section(gradient)) if gradient in section else None,
    )


def _out_of_machine(section: YamlSection, folder: Path) -> OutOfMachine:
    section.warn_unknown("points", "constant_mm", "per_metre_mm", "sigma_mm")
    if not any(key in section for key in ("points", "constant_mm", "per_metre_mm", "sigma_mm")):
        raise InputError(
            f"{section.where}: expected points, or constant_mm and per_metre_mm, or sigma_mm."
        )
    small = -1e-300
    return OutOfMachine(
        points=folder / section.text("points") if "points" in section else None,
        constant_mm=section.number("constant_mm", above=small) if "constant_mm" in section else 0.0,
        per_metre_mm=(
            section.number("per_metre_mm", above=small) if "per_metre_mm" in section else 0.0
        ),
        sigma_mm=read_sigma(section) if "sigma_mm" in section else None,
    )


def _contributors(root: YamlSection) -> tuple[Contributor, ...]:
    given = root.values.get("contributors") or []
    if not isinstance(given, list):
        raise InputError(f"{root.where}: expected a list of contributors, got {given!r}.")
    found = tuple(
        _contributor(YamlSection(entry, f"{root.where}: contributors, entry {number}"))
        for number, entry in enumerate(given, start=1)
    )
    names = [one.name for one in found]
    _once(names, f"{root.where}: contributors")
    for one in found:
        for other, r in one.correlation.items():
            if other == one.name or not -1.0 <= r <= 1.0:
                raise InputError(
                    f"{root.where}: expected the correlation of {one.name} as a number from -1 to 1"
                    f" with another contributor, got {other}: {r}."
                )
            back = found[names.index(other)].correlation if other in names else {}
            if back.get(one.name, r) != r:
                raise InputError(
                    f"{root.where}: {one.name} and {other} tell different correlations of the two."
                )
    return found


def _contributor(entry: YamlSection) -> Contributor:
    name = entry.text("name")
    if name in ("u_ip", "u_it", "u_out", "u_machine"):
        raise InputError(f"{entry.where}: the name {name} is taken: choose another.")
    entry = YamlSection(entry.values, f"{entry.where} ({name})")
    unit = entry.text("unit") if "unit" in entry else "mm"
    sensitivity = np.ones(3)
    if "sensitivity" in entry:
        one = not isinstance(entry.get("sensitivity"), list)
        sensitivity = (
            np.full(3, entry.number("sensitivity")) if one else entry.numbers("sensitivity", 3)
        )
    elif unit not in LENGTHS_MM:
        raise InputError(f"{entry.where}: a sensitivity is needed: how many mm one {unit} makes.")
    correlation = entry.section("correlation") if "correlation" in entry else None
    return Contributor(
        name=name,
        unit=unit,
        distribution=read_spread(entry, ("name", "unit", "sensitivity", "correlation")),
        sensitivity=sensitivity * LENGTHS_MM.get(unit, 1.0),
        correlation=(
            {str(other): correlation.number(other) for other in correlation.values}
            if correlation
            else {}
        ),
    )


def _probability(root: YamlSection) -> float | None:
    if "coverage_probability" not in root:
        return None
    value = root.number("coverage_probability", above=0.0)
    if value >= 1.0:
        raise InputError(f"{root.where}: expected coverage_probability below 1, got {value}.")
    return value


def _once(names: list[str], where: str) -> None:
    twice = sorted(name for name, number in Counter(names).items() if number > 1)[:10]
    if twice:
        raise InputError(
            f"{where}: expected each name once, got {', '.join(twice)} more than once."
        )
