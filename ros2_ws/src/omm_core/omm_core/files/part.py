"""The part: which coded targets it carries, and where they are in the ideal part frame.

``load_part`` reads ``part.yaml`` (contract.md, "Files"). The coordinates come from
photogrammetry outside the machine, best-fitted to the CAD surfaces.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError, warn
from omm_core.files.declared import (
    Reader,
    choice,
    direction,
    each,
    expect_once,
    integer,
    number,
    numbers,
    part_of,
    per_axis,
    read_section,
    write_section,
)
from omm_core.files.outside import Source
from omm_core.files.wishes import BOX, TOLERANCES, Jack, Nominal
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]

FAMILIES = ("aicon12", "aicon14", "metashape12", "metashape14")


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

    id: Annotated[int, integer(minimum=1)]
    xyz_mm: Annotated[Array, numbers(3, digits=6)]
    dot_diameter_mm: Annotated[float, number(above=0.0)]
    normal: Annotated[Array | None, direction()] = None
    sigma_xyz_mm: Annotated[Array | None, per_axis(least=0.0, digits=6)] = None


def _name(root: YamlSection, key: str) -> str:
    return root.section(key).text("name")


def _targets(root: YamlSection, key: str) -> tuple[Target, ...]:
    entries = root.sections(key)
    if not entries:
        raise InputError(f"{root.where}: expected a list of targets with at least one entry.")
    targets = tuple(_target(entry) for entry in entries)
    expect_once([target.id for target in targets], f"{root.where}: {key}", "target id")
    return targets


def _target(entry: YamlSection) -> Target:
    """Read a target; what is wrong with it is told with its number as well."""
    identifier = entry.integer("id", minimum=1)
    return read_section(Target, entry.renamed(f"{entry.where} (id {identifier})"))


def _covariance(root: YamlSection, key: str) -> Array:
    """Read the covariance, (3T, 3T) in the order of the targets."""
    rows, size = root.get(key), 3 * len(root.sections("targets"))
    if not isinstance(rows, list) or len(rows) != size:
        got = len(rows) if isinstance(rows, list) else rows
        raise InputError(
            f"{root.where}: expected '{key}' with {size} rows, three for each target, got {got}."
            " Take a target's rows and columns out with it."
        )
    named = YamlSection(
        {f"row {i}": row for i, row in enumerate(rows, start=1)}, f"{root.where}: {key}"
    )
    matrix = np.array([named.numbers(f"row {i}", size) for i in range(1, size + 1)])
    sigma = np.sqrt(np.abs(np.diag(matrix)))
    scale = np.where(np.outer(sigma, sigma) > 0.0, np.outer(sigma, sigma), 1.0)
    if np.any(np.abs(matrix - matrix.T) > 1e-6 * scale) or (
        np.linalg.eigvalsh((matrix + matrix.T) / (2 * scale)).min() < -1e-6
    ):
        raise InputError(
            f"{root.where}: expected {key} to be symmetric without negative variances."
        )
    return (matrix + matrix.T) / 2


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

    name: Annotated[str, Reader(_name, lambda name: {"name": name}), "part"]
    target_family: Annotated[str, choice(*FAMILIES)]
    targets: Annotated[tuple[Target, ...], Reader(_targets, each(Target).write)]
    covariance_mm2: Annotated[Array | None, Reader(_covariance, np.ndarray.tolist)] = None
    box_mm: Annotated[Array | None, BOX] = None
    nominal: Annotated[Nominal | None, part_of(Nominal)] = None
    tolerances: Annotated[Mapping[str, float], TOLERANCES] = field(default_factory=dict)
    jacks: Annotated[tuple[Jack, ...], each(Jack, once="name")] = ()

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


def load_part(path: Source) -> Part:
    """Read ``part.yaml``.

    Raises
    ------
    InputError
        Where the file is missing or malformed, a number is bad, or an id stands there twice.
    """
    root = read_yaml(path, "part file")
    part = read_section(Part, root)
    if part.covariance_mm2 is not None:
        _tell_disagreement(root, part.targets, np.sqrt(np.diag(part.covariance_mm2)))
    return part


def part_yaml(part: Part) -> str:
    """Return the ``part.yaml`` from which `load_part` makes this part."""
    import yaml

    return str(
        yaml.safe_dump(write_section(part), sort_keys=False, default_flow_style=None, width=100)
    )


def looks_like_part(path: Source) -> bool:
    """Return whether a file is YAML with a part's keys, so that its errors concern a part."""
    try:
        values = read_yaml(path, "part file").values
    except InputError:
        return False
    return {"part", "targets"} <= set(values)


def _tell_disagreement(root: YamlSection, targets: tuple[Target, ...], sigma_mm: Array) -> None:
    for i, target in enumerate(targets):
        of_matrix, told = sigma_mm[3 * i : 3 * i + 3], target.sigma_xyz_mm
        if told is not None and np.any(np.abs(told - of_matrix) > 0.05 * of_matrix + 2e-6):
            warn(
                f"{root.where}: target {target.id}: sigma_xyz_mm {told} is not what covariance_mm2"
                f" says ({np.round(of_matrix, 6)}); the latter is used."
            )
