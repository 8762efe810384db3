"""The part: which coded targets it carries, and where they are in the ideal part frame.

``load_part`` reads ``part.yaml`` (contract.md, "Files"). The coordinates come from
photogrammetry outside the machine, best-fitted to the CAD surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """One ring-coded target on the part.

    Attributes
    ----------
    id : int
        Number in the target family.
    xyz_mm : (3,) array
        Centre of the dot, part frame.
    dot_diameter_mm : float
        Diameter of the inner dot.
    normal : (3,) unit array or None
        Outward, part frame; None where the file does not tell it.
    sigma_xyz_mm : (3,) array or None
        Standard deviations of ``xyz_mm``; None where not told (then taken as exact).
    """

    id: int
    xyz_mm: Array
    dot_diameter_mm: float
    normal: Array | None = None
    sigma_xyz_mm: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A part and its targets, in the order of the file."""

    name: str
    target_family: str
    targets: tuple[Target, ...]

    def target(self, target_id: int) -> Target | None:
        """Return the target with a number, or None."""
        return next((target for target in self.targets if target.id == target_id), None)

    def normal_of(self, target: Target) -> Array | None:
        """Return the normal of a target: its own, else that of the plane fitted to all targets.

        Only the direction counts, not the sign: a circle looks the same from either side. None
        where the targets span no plane; the dot is then taken as facing the camera.
        """
        return target.normal if target.normal is not None else self.plane_normal()

    def plane_normal(self) -> Array | None:
        """Return the unit normal of the plane fitted to the targets, or None (fewer than 3)."""
        points = np.array([target.xyz_mm for target in self.targets])
        if len(points) < 3:
            return None
        _, spread, axes = np.linalg.svd(points - points.mean(axis=0))
        return None if spread[1] < 1e-6 * spread[0] else np.asarray(axes[2])


def load_part(path: str | Path) -> Part:
    """Read ``part.yaml``.

    Raises
    ------
    InputError
        Where the file is missing or malformed, a number is bad, or an id stands there twice.
    """
    root = read_yaml(path, "part file")
    entries = root.get("targets")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{root.where}: expected a list of targets with at least one entry.")
    targets = tuple(
        _target(YamlSection(entry, f"{root.where}: targets, entry {number}"))
        for number, entry in enumerate(entries, start=1)
    )
    ids = [target.id for target in targets]
    twice = sorted({i for i in ids if ids.count(i) > 1})
    if twice:
        raise InputError(
            f"{root.where}: expected each target id once, got"
            f" {', '.join(str(i) for i in twice)} more than once."
        )
    return Part(
        name=root.section("part").text("name"),
        target_family=_family(root),
        targets=targets,
    )


def _family(root: YamlSection) -> str:
    known = ("aicon12", "aicon14", "metashape12", "metashape14")
    family = root.text("target_family")
    if family not in known:
        raise InputError(
            f"{root.where}: expected a target_family out of {', '.join(known)}, got '{family}'."
        )
    return family


def _target(entry: YamlSection) -> Target:
    target_id = entry.integer("id", minimum=1)
    named = YamlSection(entry.values, f"{entry.where} (id {target_id})")
    return Target(
        id=target_id,
        xyz_mm=named.numbers("xyz_mm", 3),
        dot_diameter_mm=named.number("dot_diameter_mm", above=0.0),
        normal=_unit_normal(named) if "normal" in named else None,
        sigma_xyz_mm=_sigma(named) if "sigma_xyz_mm" in named else None,
    )


def _unit_normal(entry: YamlSection) -> Array:
    normal = entry.numbers("normal", 3)
    length = float(np.linalg.norm(normal))
    if length < 1e-6:
        raise InputError(f"{entry.where}: expected a normal with a direction, got {normal}.")
    return normal / length


def _sigma(entry: YamlSection) -> Array:
    """Read one standard deviation for all axes, or one for each."""
    if isinstance(entry.get("sigma_xyz_mm"), list):
        sigma = entry.numbers("sigma_xyz_mm", 3)
    else:
        sigma = np.full(3, entry.number("sigma_xyz_mm"))
    if np.any(sigma < 0.0):
        raise InputError(f"{entry.where}: expected sigma_xyz_mm >= 0, got {sigma}.")
    return sigma
