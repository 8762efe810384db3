"""The machine: how exact and how fast it is, and what its control's further axes are.

``load_machine`` reads machine.yaml (contract.md, "Files") or a URDF, told apart by content: a URDF
is XML. The kinematics stand in the URDF that ``Machine.urdf`` names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.declared import (
    direction,
    file,
    number,
    read_optional,
    read_section,
    text,
    truth,
)
from omm_core.files.outside import Source, read_bytes
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]

_LIMITS = {"velocity": "s", "acceleration": "s2", "jerk": "s3"}
_LIMIT_KEYS = tuple(f"{n}_{unit}_per_{per}" for n, per in _LIMITS.items() for unit in ("mm", "rad"))


@dataclass(frozen=True, kw_only=True)
class MachineUncertainty:
    """How exact the machine is; None where it is to be estimated from the run.

    Attributes
    ----------
    stop_sigma_mm : float or None
        Standard deviation of each axis, each stop anew (repeatability).
    geometry_sigma_mm, geometry_length_mm : float or None
        Errors that vary smoothly over the working volume: covariance
        ``sigma² exp(-d² / (2 length²))`` between commanded spindle places d apart, each axis.
    """

    stop_sigma_mm: Annotated[float | None, number(least=0.0)] = None
    geometry_sigma_mm: Annotated[float | None, number(least=0.0)] = None
    geometry_length_mm: Annotated[float | None, number(above=0.0)] = None


@dataclass(frozen=True, kw_only=True)
class Follows:
    """An axis that goes with another one."""

    leader: str
    tolerance: float | None = None
    """mm, or rad where the leader turns; None where the file does not say."""
    in_rad: bool | None = field(default=None, compare=False)
    """Whether the file gives the tolerance in rad; None where it gives none."""


@dataclass(frozen=True, kw_only=True)
class AxisDynamics:
    """How fast an axis is, in mm (rad where it turns) and seconds; None where not told."""

    velocity: float | None = None
    acceleration: float | None = None
    jerk: float | None = None


@dataclass(frozen=True, kw_only=True)
class Timing:
    """What a stop costs besides the way there; None where not told."""

    settling_s: Annotated[float | None, number(least=0.0)] = None
    image_s: Annotated[float | None, number(least=0.0)] = None


@dataclass(frozen=True, kw_only=True, eq=False)
class _Head:
    urdf: Annotated[Path, file()]
    name: Annotated[str | None, text()] = None
    up: Annotated[Array, direction()] = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True, kw_only=True)
class _Axis:
    follows: Annotated[str | None, text()] = None
    tolerance_mm: Annotated[float | None, number(above=0.0)] = None
    tolerance_rad: Annotated[float | None, number(above=0.0)] = None
    ignored: Annotated[bool, truth()] = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Machine:
    """What machine.yaml says; a URDF alone says nothing but where the kinematics are.

    Attributes
    ----------
    name : str
        For people; the file's name where it is a URDF.
    urdf : Path
        The kinematics.
    up : (3,) unit array
        Against gravity, machine frame.
    uncertainty : MachineUncertainty
    dynamics : mapping
        By axis, as the control names it.
    follows : mapping
        Second drives, by axis.
    ignored : frozenset of str
        Axes that the control reports and that move neither spindle nor part.
    timing : Timing
    """

    name: str
    urdf: Path
    up: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    uncertainty: MachineUncertainty = MachineUncertainty()
    dynamics: Mapping[str, AxisDynamics] = field(default_factory=dict)
    follows: Mapping[str, Follows] = field(default_factory=dict)
    ignored: frozenset[str] = frozenset()
    timing: Timing = Timing()


def load_machine(path: Source) -> Machine:
    """Read a machine.yaml or a URDF; the URDF itself is not opened here.

    Raises
    ------
    InputError
        Where the file cannot be read, or says something else than the contract has.
    """
    if _is_xml(path):
        return Machine(name=Path(str(path)).stem, urdf=Path(str(path)))
    root = read_yaml(path, "machine.yaml (or URDF)")
    root.check_keys("machine", "uncertainty", "axes", "timing")
    head = read_section(_Head, root.section("machine"))
    axes = root.section("axes") if "axes" in root else None
    follows, ignored, dynamics = _axes(axes) if axes else ({}, frozenset(), {})
    return Machine(
        name=head.name or Path(str(path)).stem,
        urdf=head.urdf,
        up=head.up,
        uncertainty=read_optional(MachineUncertainty, root, "uncertainty") or MachineUncertainty(),
        dynamics=dynamics,
        follows=follows,
        ignored=ignored,
        timing=read_optional(Timing, root, "timing") or Timing(),
    )


def _is_xml(path: Source) -> bool:
    """Return whether the file is XML.

    A file that is not UTF-8 text counts as XML, which declares its own encoding.
    """
    start = read_bytes(path, "machine (URDF or machine.yaml)")[:4096]
    if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return True
    return start.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<")


def _axes(
    axes: YamlSection,
) -> tuple[dict[str, Follows], frozenset[str], dict[str, AxisDynamics]]:
    follows: dict[str, Follows] = {}
    ignored: set[str] = set()
    dynamics: dict[str, AxisDynamics] = {}
    for name in axes.values:
        if name not in axes:  # "X:" with nothing behind it
            continue
        section = axes.section(name)
        axis = read_section(_Axis, section, also=_LIMIT_KEYS)
        if axis.follows is not None:
            follows[str(name)] = _follows(str(name), axis, section.where)
        if axis.ignored:
            ignored.add(str(name))
        told = {key: _limit(section, key, per) for key, per in _LIMITS.items()}
        if any(value is not None for value in told.values()):
            dynamics[str(name)] = AxisDynamics(**told)
    both = sorted(ignored & {*follows, *(f.leader for f in follows.values())})
    if both:
        raise InputError(
            f"{axes.where}: expected {', '.join(both)} to be ignored or to follow, got both."
        )
    _refuse_circles(follows, axes.where)
    return follows, frozenset(ignored), dynamics


def _refuse_circles(follows: Mapping[str, Follows], where: str) -> None:
    """Raise InputError where axes follow each other: then the URDF has none of them."""
    for name in follows:
        way, leader = [name], follows[name].leader
        while leader in follows and leader not in way:
            way.append(leader)
            leader = follows[leader].leader
        if leader in way:
            raise InputError(
                f"{where}: expected {name} to follow an axis of the URDF, got axes that follow"
                f" each other: {', '.join(way)}."
            )


def _limit(axis: YamlSection, name: str, per: str) -> float | None:
    keys = [key for key in (f"{name}_mm_per_{per}", f"{name}_rad_per_{per}") if key in axis]
    if len(keys) > 1:
        raise InputError(f"{axis.where}: expected one of {' and '.join(keys)}, got both.")
    return axis.number(keys[0], above=0.0) if keys else None


def _follows(name: str, axis: _Axis, where: str) -> Follows:
    if axis.follows == name:
        raise InputError(f"{where}: expected another axis to follow, got itself.")
    if axis.tolerance_mm is not None and axis.tolerance_rad is not None:
        raise InputError(f"{where}: expected one of tolerance_mm and tolerance_rad, got both.")
    in_rad = axis.tolerance_rad is not None
    tolerance = axis.tolerance_rad if in_rad else axis.tolerance_mm
    return Follows(
        leader=str(axis.follows),
        tolerance=tolerance,
        in_rad=None if tolerance is None else in_rad,
    )
