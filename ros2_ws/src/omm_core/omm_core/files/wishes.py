"""What part.yaml says for planning, aligning and the screen: box, place, tolerances, jacks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection

Array = NDArray[np.float64]
TOLERATED = ("alpha_rad", "beta_rad", "gamma_rad", "x_mm", "y_mm", "z_mm")
"""Names of what may have a tolerance, in the order of the pose's θ."""

Three = tuple[float | None, float | None, float | None]


@dataclass(frozen=True, kw_only=True)
class Nominal:
    """machine_T_part as it is wanted; None is "anywhere"."""

    translation_mm: Three
    euler_xyz_rad: Three

    def complete(self) -> bool:
        """Return whether the wish names one place and no "anywhere"."""
        return None not in (*self.translation_mm, *self.euler_xyz_rad)


@dataclass(frozen=True, kw_only=True, eq=False)
class Jack:
    """A jack: where it carries the part, and how far it may still be turned.

    Attributes
    ----------
    xyz_mm : (3,) array
        From the part's origin, in the machine's axes.
    travel_mm : tuple of two
        Lowest and highest correction that the jack can still make.
    """

    name: str
    xyz_mm: Array
    travel_mm: tuple[float, float] = (-np.inf, np.inf)


def read_box(root: YamlSection) -> Array | None:
    """Return ``box_mm`` as (lowest corner, highest corner), (2, 3), or None where not told."""
    if "box_mm" not in root:
        return None
    corners = _two(root.get("box_mm"), f"{root.where}: expected two corners for 'box_mm'")
    rows = YamlSection(dict(zip(("lowest", "highest"), corners)), f"{root.where}: box_mm")
    box = np.array([rows.numbers("lowest", 3), rows.numbers("highest", 3)])
    if np.any(box[0] > box[1]):
        raise InputError(
            f"{root.where}: expected the lowest corner of 'box_mm' first, got {corners}."
        )
    return box


def read_nominal(root: YamlSection) -> Nominal | None:
    """Return ``nominal``, or None where not told."""
    if "nominal" not in root:
        return None
    section = root.section("nominal")
    return Nominal(
        translation_mm=_three(section, "translation_mm"),
        euler_xyz_rad=_three(section, "euler_xyz_rad"),
    )


def read_tolerances(root: YamlSection) -> dict[str, float]:
    """Return ``tolerances``: plus/minus about nominal, by name, in the order of θ."""
    if "tolerances" not in root:
        return {}
    section = root.section("tolerances")
    unknown = [str(name) for name in section.values if name not in TOLERATED]
    if unknown:
        raise InputError(
            f"{section.where}: expected tolerances of {', '.join(TOLERATED)}, got"
            f" {', '.join(unknown)}."
        )
    return {name: section.number(name, above=0.0) for name in TOLERATED if name in section}


def read_jacks(root: YamlSection) -> tuple[Jack, ...]:
    """Return ``jacks``, empty where there are none."""
    if "jacks" not in root:
        return ()
    entries = root.get("jacks")
    if not isinstance(entries, list):
        raise InputError(f"{root.where}: expected a list for 'jacks', got {entries!r}.")
    jacks = tuple(
        _jack(YamlSection(entry, f"{root.where}: jacks, entry {number}"))
        for number, entry in enumerate(entries, start=1)
    )
    names = [jack.name for jack in jacks]
    if twice := sorted(name for name, number in Counter(names).items() if number > 1):
        raise InputError(
            f"{root.where}: expected each jack's name once, got {', '.join(twice)} more than once."
        )
    return jacks


def _jack(entry: YamlSection) -> Jack:
    travel = entry.numbers("travel_mm", 2) if "travel_mm" in entry else np.array([-np.inf, np.inf])
    if not travel[0] <= travel[1]:
        raise InputError(f"{entry.where}: expected travel_mm as [lowest, highest], got {travel}.")
    return Jack(
        name=entry.text("name"),
        xyz_mm=entry.numbers("xyz_mm", 3),
        travel_mm=(float(travel[0]), float(travel[1])),
    )


def _three(section: YamlSection, key: str) -> Three:
    """Read three numbers, any of which may be null; all three where the key is null or absent."""
    if key not in section:
        return (None, None, None)
    given = section.get(key)
    if not isinstance(given, list) or len(given) != 3:
        raise InputError(f"{section.where}: expected 3 numbers or nulls for '{key}', got {given}.")
    told = {str(i): value for i, value in enumerate(given)}
    each = YamlSection(told, f"{section.where}: {key}")
    x, y, z = (each.number(i) if i in each else None for i in told)
    return (x, y, z)


def _two(value: object, expected: str) -> Sequence[object]:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"{expected}, got {value!r}.")
    return value
