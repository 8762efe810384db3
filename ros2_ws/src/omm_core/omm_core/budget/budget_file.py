"""budget.yaml: the contributors of an uncertainty budget (contract.md, "Files")."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.contributor import Contributor, expect_once, read_contributors
from omm_core.budget.distributions import Distribution
from omm_core.budget.spread_reading import SPREAD_KEYS, read_sigma, read_spread
from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]

_ROOT = ("part", "points", "u_ip", "u_it", "u_out", "machine", "contributors", "coverage_factor",
         "coverage_probability", "tolerance_mm", "tool_mm", "cad", "cad_unit")  # fmt: skip
_LARGEST_PER_K = 1e-3
# Of STL and PLY, which do not tell theirs; as in fit.yaml.
CAD_UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}


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
class BudgetFile:
    """What budget.yaml says; ``points`` is None where the box of the part is meant.

    ``cad`` is the part's surface, in the part frame, for the map of U over it.
    """

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
    cad: Path | None
    cad_unit_mm: float


def load_budget_file(path: Path) -> BudgetFile:
    """Read budget.yaml, or the one in a folder; paths in it are relative to it.

    Raises
    ------
    InputError
        Where the file is missing or malformed, or names no contributor at all.
    """
    path = path / "budget.yaml" if path.is_dir() else path
    root = read_yaml(path, "budget file")
    root.refuse_unknown(*_ROOT)
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
        contributors=read_contributors(root),
        coverage_factor=2.0 if factor is None and probability is None else factor,
        coverage_probability=probability,
        tolerance_mm=root.number("tolerance_mm", above=0.0) if "tolerance_mm" in root else None,
        cad=path.parent / root.text("cad") if "cad" in root else None,
        cad_unit_mm=_cad_unit_mm(root),
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
    expect_once([point.name for point in points], f"{root.where}: points")
    return points


def _in_part(section: YamlSection, folder: Path) -> InPart:
    section.refuse_unknown("run", "campaign", "sigma_mm")
    if not any(key in section for key in ("run", "campaign", "sigma_mm")):
        raise InputError(f"{section.where}: expected run, campaign or sigma_mm.")
    return InPart(
        run=folder / section.text("run") if "run" in section else None,
        campaign=folder / section.text("campaign") if "campaign" in section else None,
        sigma_mm=read_sigma(section) if "sigma_mm" in section else None,
    )


def _expansion(section: YamlSection) -> Expansion:
    section.refuse_unknown("expansion_per_K", "temperature_K", "gradient_K_per_m", "sigma_mm")
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
    if abs(per_K) > _LARGEST_PER_K:
        raise InputError(
            f"{section.where}: expected expansion_per_K as 11.0e-6 (per K), got {per_K:g}:"
            " no solid expands so much. Is that µm per m and K?"
        )
    temperature = section.section("temperature_K") if "temperature_K" in section else None
    gradient = "gradient_K_per_m"
    if temperature is None and gradient not in section:
        raise InputError(
            f"{section.where}: expected temperature_K or {gradient} beside expansion_per_K: how"
            " unsure the part's temperature is."
        )
    return Expansion(
        per_K=per_K,
        per_K_spread=spread,
        mean_K=temperature.number("mean") if temperature and "mean" in temperature else 0.0,
        temperature=read_spread(temperature, ("mean",)) if temperature else None,
        gradient=read_spread(section.section(gradient)) if gradient in section else None,
    )


def _out_of_machine(section: YamlSection, folder: Path) -> OutOfMachine:
    section.refuse_unknown("points", "constant_mm", "per_metre_mm", "sigma_mm")
    if not any(key in section for key in ("points", "constant_mm", "per_metre_mm", "sigma_mm")):
        raise InputError(
            f"{section.where}: expected points, or constant_mm and per_metre_mm, or sigma_mm."
        )
    return OutOfMachine(
        points=folder / section.text("points") if "points" in section else None,
        constant_mm=section.number("constant_mm", least=0.0) if "constant_mm" in section else 0.0,
        per_metre_mm=(
            section.number("per_metre_mm", least=0.0) if "per_metre_mm" in section else 0.0
        ),
        sigma_mm=read_sigma(section) if "sigma_mm" in section else None,
    )


def _probability(root: YamlSection) -> float | None:
    if "coverage_probability" not in root:
        return None
    value = root.number("coverage_probability", above=0.0)
    if value >= 1.0:
        raise InputError(f"{root.where}: expected coverage_probability below 1, got {value}.")
    return value


def _cad_unit_mm(root: YamlSection) -> float:
    unit = root.text("cad_unit") if "cad_unit" in root else "mm"
    if unit not in CAD_UNITS_MM:
        raise InputError(
            f"{root.where}: expected cad_unit out of {', '.join(CAD_UNITS_MM)}, got {unit!r}."
        )
    return CAD_UNITS_MM[unit]
