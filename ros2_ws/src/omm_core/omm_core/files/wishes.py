"""What part.yaml says for planning, aligning and the screen: box, place, tolerances, jacks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.declared import Reader, numbers, text
from omm_core.files.yaml_input import YamlSection

Array = NDArray[np.float64]
TOLERATED = ("alpha_rad", "beta_rad", "gamma_rad", "x_mm", "y_mm", "z_mm")
"""Names of what may have a tolerance, in the order of the pose's θ."""

Three = tuple[float | None, float | None, float | None]


def _three(section: YamlSection, key: str) -> Three:
    """Read three numbers, any of which may be null."""
    given = section.get(key)
    if not isinstance(given, list) or len(given) != 3:
        raise InputError(f"{section.where}: expected 3 numbers or nulls for '{key}', got {given}.")
    told = {str(i): value for i, value in enumerate(given)}
    each = YamlSection(told, f"{section.where}: {key}")
    x, y, z = (each.number(i) if i in each else None for i in told)
    return (x, y, z)


def _travel(section: YamlSection, key: str) -> tuple[float, float]:
    low, high = (float(v) for v in section.numbers(key, 2))
    if low > high:
        raise InputError(
            f"{section.where}: expected {key} as [lowest, highest], got {low}, {high}."
        )
    return low, high


def _box(root: YamlSection, key: str) -> Array:
    """Read a box as (lowest corner, highest corner), (2, 3)."""
    corners = root.get(key)
    if not isinstance(corners, list) or len(corners) != 2:
        raise InputError(f"{root.where}: expected two corners for '{key}', got {corners!r}.")
    rows = YamlSection(dict(zip(("lowest", "highest"), corners)), f"{root.where}: {key}")
    box = np.array([rows.numbers("lowest", 3), rows.numbers("highest", 3)])
    if np.any(box[0] > box[1]):
        raise InputError(
            f"{root.where}: expected the lowest corner of '{key}' first, got {corners}."
        )
    return box


def _tolerances(root: YamlSection, key: str) -> dict[str, float]:
    """Read plus/minus about nominal, by name, in the order of θ."""
    section = root.section(key)
    # A tolerance that nobody checks would count as kept.
    YamlSection(section.values, section.where, strict=True).check_keys(*TOLERATED)
    return {name: section.number(name, above=0.0) for name in TOLERATED if name in section}


BOX = Reader(_box, lambda box: [[round(float(v), 6) for v in corner] for corner in box])
TOLERANCES = Reader(_tolerances, dict)


@dataclass(frozen=True, kw_only=True)
class Nominal:
    """machine_T_part as it is wanted; None is "anywhere"."""

    translation_mm: Annotated[Three, Reader(_three, list)] = (None, None, None)
    euler_xyz_rad: Annotated[Three, Reader(_three, list)] = (None, None, None)

    def complete(self) -> bool:
        """Return whether the wish names one place and no "anywhere"."""
        return None not in (*self.translation_mm, *self.euler_xyz_rad)


@dataclass(frozen=True, kw_only=True, eq=False)
class Jack:
    """A jack: where it carries the part, and how far it may still be turned.

    Attributes
    ----------
    xyz_mm : (3,) array
        Where it carries the part, in the part's frame, as all of the part file.
    travel_mm : tuple of two
        Lowest and highest correction that the jack can still make.
    """

    name: Annotated[str, text()]
    xyz_mm: Annotated[Array, numbers(3)]
    travel_mm: Annotated[tuple[float, float], Reader(_travel, list)] = (-np.inf, np.inf)
