"""budget.yaml: the contributors of an uncertainty budget (contract.md, "Files")."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.contributor import Contributor, read_contributors
from omm_core.budget.distributions import Distribution
from omm_core.budget.spread_reading import SPREAD_KEYS, read_sigma, read_spread
from omm_core.errors import InputError
from omm_core.files.declared import (
    file,
    number,
    numbers,
    per_axis,
    read_each,
    read_optional,
    text,
)
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]
_T = TypeVar("_T")

_ROOT = ("part", "points", "u_ip", "u_it", "u_out", "machine", "contributors", "coverage_factor",
         "coverage_probability", "tolerance_mm", "tool_mm", "cad", "cad_unit")  # fmt: skip
_LARGEST_PER_K = 1e-3
# Of STL and PLY, which do not tell theirs; as in fit.yaml.
CAD_UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}


@dataclass(frozen=True, kw_only=True, eq=False)
class NamedPoint:
    """A point of the part, part frame; its deviation from nominal (mm, three axes) where told."""

    name: Annotated[str, text()]
    xyz_mm: Annotated[Array, numbers(3)]
    deviation_mm: Annotated[Array | None, numbers(3)] = None


def _points(root: YamlSection, key: str) -> tuple[NamedPoint, ...] | None:
    if root.get(key) == "box":
        return None
    if not isinstance(root.get(key), list) or not root.get(key):
        raise InputError(f"{root.where}: expected 'box' or a list for '{key}'.")
    return read_each(NamedPoint, root, key, once="name")


@dataclass(frozen=True, kw_only=True, eq=False)
class InPart:
    """Where u_ip comes from; several may be there."""

    run: Annotated[Path | None, file()] = None
    campaign: Annotated[Path | None, file()] = None
    sigma_mm: Annotated[Array | None, per_axis(least=0.0)] = None


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

    points: Annotated[Path | None, file()] = None
    constant_mm: Annotated[float, number(least=0.0)] = 0.0
    per_metre_mm: Annotated[float, number(least=0.0)] = 0.0
    sigma_mm: Annotated[Array | None, per_axis(least=0.0)] = None


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
    root.check_keys(*_ROOT)
    factor = root.number("coverage_factor", above=0.0) if "coverage_factor" in root else None
    probability = _probability(root)
    if factor is not None and probability is not None:
        raise InputError(
            f"{root.where}: expected coverage_factor or coverage_probability, got both."
        )
    told = BudgetFile(
        path=path,
        part=path.parent / root.text("part"),
        points=_points(root, "points") if "points" in root else None,
        u_ip=_some(InPart, root, "u_ip", expected="run, campaign or sigma_mm"),
        u_it=_expansion(root.section("u_it")) if "u_it" in root else None,
        u_out=_some(
            OutOfMachine,
            root,
            "u_out",
            expected="points, or constant_mm and per_metre_mm, or sigma_mm",
        ),
        machine=path.parent / root.text("machine") if "machine" in root else None,
        tool_mm=root.numbers("tool_mm", 3) if "tool_mm" in root else np.zeros(3),
        contributors=read_contributors(root),
        coverage_factor=2.0 if factor is None and probability is None else factor,
        coverage_probability=probability,
        tolerance_mm=root.number("tolerance_mm", above=0.0) if "tolerance_mm" in root else None,
        cad=path.parent / root.text("cad") if "cad" in root else None,
        cad_unit_mm=_cad_unit_mm(root),
    )
    if not (told.u_ip or told.u_it or told.u_out or told.machine or told.contributors):
        raise InputError(
            f"{root.where}: expected at least one of u_ip, u_it, u_out, machine, contributors."
        )
    return told


def _some(cls: type[_T], root: YamlSection, key: str, *, expected: str) -> _T | None:
    """Read a section in which at least one thing must stand; None where it is absent."""
    found = read_optional(cls, root, key)
    if found is not None and not any(one in root.section(key) for one in root.section(key).values):
        raise InputError(f"{root.where}: {key}: expected {expected}.")
    return found


def _expansion(section: YamlSection) -> Expansion:
    section.check_keys("expansion_per_K", "temperature_K", "gradient_K_per_m", "sigma_mm")
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
            " no solid expands that much. Is that µm per m and K?"
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
            f"{root.where}: expected cad_unit to be one of {', '.join(CAD_UNITS_MM)}, got {unit!r}."
        )
    return CAD_UNITS_MM[unit]
