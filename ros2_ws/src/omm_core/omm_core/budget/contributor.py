"""The contributors that budget.yaml lists itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.distributions import Distribution
from omm_core.budget.spread_reading import read_spread
from omm_core.errors import InputError
from omm_core.files.declared import expect_once, per_axis
from omm_core.files.yaml_input import YamlSection

Array = NDArray[np.float64]

# What a length's unit is in mm; of any other unit the sensitivity says how many mm it makes.
LENGTHS_MM = {"m": 1e3, "mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "nm": 1e-6}


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


def read_contributors(root: YamlSection) -> tuple[Contributor, ...]:
    """Read ``contributors`` of budget.yaml.

    Raises
    ------
    InputError
        Where one is malformed, named twice, or correlated in a way that cannot be.
    """
    found = tuple(_contributor(entry) for entry in root.sections("contributors"))
    names = [one.name for one in found]
    expect_once(names, f"{root.where}: contributors")
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
                    f"{root.where}: {one.name} and {other} give different correlations for the two."
                )
    return found


def _contributor(entry: YamlSection) -> Contributor:
    name = entry.text("name")
    if name in ("u_ip", "u_it", "u_out", "u_machine"):
        raise InputError(f"{entry.where}: the name {name} is taken: choose another.")
    entry = entry.renamed(f"{entry.where} ({name})")
    unit = entry.text("unit") if "unit" in entry else "mm"
    sensitivity = np.ones(3)
    if "sensitivity" in entry:
        sensitivity = per_axis().read(entry, "sensitivity")
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
