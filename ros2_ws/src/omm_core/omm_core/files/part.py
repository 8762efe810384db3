"""The part: which coded targets it carries, and where they are in the ideal part frame.

``load_part`` reads ``part.yaml`` (contract.md, "Files"). The coordinates come from
photogrammetry outside the machine, best-fitted to the CAD surfaces.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError, warn
from omm_core.files.wishes import (
    Jack,
    Nominal,
    read_box,
    read_jacks,
    read_nominal,
    read_tolerances,
)
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]

_KEYS = (
    "part", "target_family", "targets", "covariance_mm2", "box_mm", "nominal", "tolerances", "jacks"
)  # fmt: skip


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
        Standard deviations of ``xyz_mm``; None where not told: then the coordinates count as
        exact, and the result says so. Zeros: exact, nothing said.
    """

    id: int
    xyz_mm: Array
    dot_diameter_mm: float
    normal: Array | None = None
    sigma_xyz_mm: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A part and its targets, in the order of the file.

    Attributes
    ----------
    covariance_mm2 : (3T, 3T) array or None
        Of all coordinates, targets in their order, part frame; it takes the place of the single
        ``sigma_xyz_mm``. None where the file does not hold it.
    box_mm : (2, 3) array or None
        Lowest and highest corner, part frame; see :meth:`box`.
    nominal : Nominal or None
        machine_T_part as wanted.
    tolerances : mapping
        Plus/minus about nominal, by name (``alpha_rad`` to ``z_mm``).
    jacks : tuple of Jack
    """

    name: str
    target_family: str
    targets: tuple[Target, ...]
    covariance_mm2: Array | None = None
    box_mm: Array | None = None
    nominal: Nominal | None = None
    tolerances: Mapping[str, float] = field(default_factory=dict)
    jacks: tuple[Jack, ...] = ()

    def box(self) -> Array:
        """Return lowest and highest corner, (2, 3): the file's box, else that of the targets."""
        if self.box_mm is not None:
            return self.box_mm
        points = np.array([target.xyz_mm for target in self.targets])
        return np.array([points.min(axis=0), points.max(axis=0)])

    def box_corners(self) -> Array:
        """Return the corners of the box, (8, 3), part frame."""
        low, high = self.box()
        picks = np.array([[(i >> axis) & 1 for axis in range(3)] for i in range(8)])
        return np.where(picks == 1, high, low)

    def target_covariance_mm2(self) -> Array:
        """Return the covariance of all coordinates, (3T, 3T), zeros where none is told."""
        if self.covariance_mm2 is not None:
            return self.covariance_mm2
        exact = np.zeros(3)
        told = [exact if t.sigma_xyz_mm is None else t.sigma_xyz_mm for t in self.targets]
        return np.diag(np.concatenate(told) ** 2)

    def taken_as_exact(self) -> tuple[int, ...]:
        """Return the targets of which no uncertainty is told: the result has to say so."""
        if self.covariance_mm2 is not None:
            return ()
        return tuple(target.id for target in self.targets if target.sigma_xyz_mm is None)

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
    root.refuse_unknown(*_KEYS)
    entries = root.get("targets")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{root.where}: expected a list of targets with at least one entry.")
    targets = tuple(
        _target(YamlSection(entry, f"{root.where}: targets, entry {number}"))
        for number, entry in enumerate(entries, start=1)
    )
    ids = [target.id for target in targets]
    twice = sorted(i for i, number in Counter(ids).items() if number > 1)[:10]
    if twice:
        raise InputError(
            f"{root.where}: expected each target id once, got"
            f" {', '.join(str(i) for i in twice)} more than once."
        )
    return Part(
        name=root.section("part").text("name"),
        target_family=_family(root),
        targets=targets,
        covariance_mm2=_covariance(root, targets) if "covariance_mm2" in root else None,
        box_mm=read_box(root),
        nominal=read_nominal(root),
        tolerances=read_tolerances(root),
        jacks=read_jacks(root),
    )


def looks_like_part(path: str | Path) -> bool:
    """Return whether a file is YAML with a part's keys, so that its errors concern a part."""
    try:
        values = read_yaml(path, "part file").values
    except InputError:
        return False
    return {"part", "targets"} <= set(values)


def _covariance(root: YamlSection, targets: tuple[Target, ...]) -> Array:
    """Read ``covariance_mm2``, (3T, 3T) in the order of the targets."""
    rows, size = root.get("covariance_mm2"), 3 * len(targets)
    if not isinstance(rows, list) or len(rows) != size:
        got = len(rows) if isinstance(rows, list) else rows
        raise InputError(
            f"{root.where}: expected 'covariance_mm2' with {size} rows, three for each target, got"
            f" {got}. Take a target's rows and columns out with it."
        )
    named = YamlSection(
        {f"row {i}": row for i, row in enumerate(rows, start=1)}, f"{root.where}: covariance_mm2"
    )
    matrix = np.array([named.numbers(f"row {i}", size) for i in range(1, size + 1)])
    sigma = np.sqrt(np.abs(np.diag(matrix)))
    scale = np.where(np.outer(sigma, sigma) > 0.0, np.outer(sigma, sigma), 1.0)
    if np.any(np.abs(matrix - matrix.T) > 1e-6 * scale) or (
        np.linalg.eigvalsh((matrix + matrix.T) / (2 * scale)).min() < -1e-6
    ):
        raise InputError(
            f"{root.where}: expected covariance_mm2 to be symmetric without negative variances."
        )
    _tell_disagreement(root, targets, sigma)
    return (matrix + matrix.T) / 2


def _tell_disagreement(root: YamlSection, targets: tuple[Target, ...], sigma_mm: Array) -> None:
    for i, target in enumerate(targets):
        of_matrix, told = sigma_mm[3 * i : 3 * i + 3], target.sigma_xyz_mm
        if told is not None and np.any(np.abs(told - of_matrix) > 0.05 * of_matrix + 2e-6):
            warn(
                f"{root.where}: target {target.id}: sigma_xyz_mm {told} is not what covariance_mm2"
                f" says ({np.round(of_matrix, 6)}); the latter is used."
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
    entry.refuse_unknown("id", "xyz_mm", "dot_diameter_mm", "normal", "sigma_xyz_mm")
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
