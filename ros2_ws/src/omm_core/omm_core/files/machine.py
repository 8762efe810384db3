"""The machine: how exact and how fast it is, and what its control's further axes are.

``load_machine`` reads machine.yaml (contract.md, "Files") or a URDF, told apart by content: a URDF
is XML. The kinematics stand in the URDF that ``Machine.urdf`` names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.outside import read_bytes
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]

_LIMITS = ("velocity", "acceleration", "jerk")
_KNOWN = {
    "machine": ("name", "urdf", "up"),
    "uncertainty": ("stop_sigma_mm", "geometry_sigma_mm", "geometry_length_mm"),
    "timing": ("settling_s", "image_s"),
    "axis": (
        *(f"{name}_{unit}" for name, of in zip(_LIMITS, ("_per_s", "_per_s2", "_per_s3"))
          for unit in (f"mm{of}", f"rad{of}")),
        "follows", "tolerance_mm", "tolerance_rad", "ignored",
    ),
}  # fmt: skip


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

    stop_sigma_mm: float | None = None
    geometry_sigma_mm: float | None = None
    geometry_length_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class Follows:
    """An axis that goes with another one."""

    leader: str
    tolerance: float | None = None
    """mm, or rad where the leader turns; None where the file does not say."""


@dataclass(frozen=True, kw_only=True)
class AxisDynamics:
    """How fast an axis is, in mm (rad where it turns) and seconds; None where not told."""

    velocity: float | None = None
    acceleration: float | None = None
    jerk: float | None = None


@dataclass(frozen=True, kw_only=True)
class Timing:
    """What a stop costs besides the way there; None where not told."""

    settling_s: float | None = None
    image_s: float | None = None


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


def load_machine(path: str | Path) -> Machine:
    """Read a machine.yaml or a URDF; the URDF itself is not opened here.

    Raises
    ------
    InputError
        Where the file cannot be read, or says something else than the contract has.
    """
    path = Path(path)
    if _is_xml(path):
        return Machine(name=path.stem, urdf=path)
    root = read_yaml(path, "machine.yaml (or URDF)")
    root.refuse_unknown("machine", "uncertainty", "axes", "timing")
    machine = root.section("machine")
    _tell_unknown(machine, "machine")
    axes = root.section("axes") if "axes" in root else None
    follows, ignored, dynamics = _axes(axes) if axes else ({}, frozenset(), {})
    return Machine(
        name=machine.text("name") if "name" in machine else path.stem,
        urdf=path.parent / machine.text("urdf"),
        up=_up(machine),
        uncertainty=_uncertainty(root),
        dynamics=dynamics,
        follows=follows,
        ignored=ignored,
        timing=_timing(root),
    )


def _is_xml(path: Path) -> bool:
    """Return whether the file is XML.

    A file that is not UTF-8 text counts as XML, which declares its own encoding.
    """
    start = read_bytes(path, "machine (URDF or machine.yaml)")[:4096]
    if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return True
    return start.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<")


def _tell_unknown(section: YamlSection, kind: str) -> None:
    """Warn of keys that nothing reads: a misspelt one would be taken as not told."""
    section.refuse_unknown(*_KNOWN[kind])


def _up(machine: YamlSection) -> Array:
    up = machine.numbers("up", 3) if "up" in machine else np.array([0.0, 0.0, 1.0])
    length = float(np.linalg.norm(up))
    if length < 1e-9:
        raise InputError(f"{machine.where}: expected 'up' with a direction, got {up}.")
    return np.asarray(up / length)


def _not_negative(section: YamlSection, key: str) -> float | None:
    if key not in section:
        return None
    value = section.number(key)
    if value < 0.0:
        raise InputError(f"{section.where}: expected {key} >= 0, got {value:g}.")
    return value


def _uncertainty(root: YamlSection) -> MachineUncertainty:
    if "uncertainty" not in root:
        return MachineUncertainty()
    section = root.section("uncertainty")
    _tell_unknown(section, "uncertainty")
    length = "geometry_length_mm"
    return MachineUncertainty(
        stop_sigma_mm=_not_negative(section, "stop_sigma_mm"),
        geometry_sigma_mm=_not_negative(section, "geometry_sigma_mm"),
        geometry_length_mm=section.number(length, above=0.0) if length in section else None,
    )


def _timing(root: YamlSection) -> Timing:
    if "timing" not in root:
        return Timing()
    section = root.section("timing")
    _tell_unknown(section, "timing")
    return Timing(
        settling_s=_not_negative(section, "settling_s"), image_s=_not_negative(section, "image_s")
    )


def _axes(
    axes: YamlSection,
) -> tuple[dict[str, Follows], frozenset[str], dict[str, AxisDynamics]]:
    follows: dict[str, Follows] = {}
    ignored: set[str] = set()
    dynamics: dict[str, AxisDynamics] = {}
    for name in axes.values:
        if name not in axes:  # "X:" with nothing behind it
            continue
        axis = axes.section(name)
        _tell_unknown(axis, "axis")
        if "follows" in axis:
            follows[str(name)] = _follows(str(name), axis)
        if _is_ignored(axis):
            ignored.add(str(name))
        told = {key: _limit(axis, key, unit) for key, unit in zip(_LIMITS, ("s", "s2", "s3"))}
        if any(value is not None for value in told.values()):
            dynamics[str(name)] = AxisDynamics(**told)
    both = sorted(ignored & {*follows, *(f.leader for f in follows.values())})
    if both:
        raise InputError(
            f"{axes.where}: expected {', '.join(both)} to be ignored or to follow, got both."
        )
    return follows, frozenset(ignored), dynamics


def _limit(axis: YamlSection, name: str, per: str) -> float | None:
    keys = [key for key in (f"{name}_mm_per_{per}", f"{name}_rad_per_{per}") if key in axis]
    if len(keys) > 1:
        raise InputError(f"{axis.where}: expected one of {' and '.join(keys)}, got both.")
    return axis.number(keys[0], above=0.0) if keys else None


def _follows(name: str, axis: YamlSection) -> Follows:
    leader = axis.text("follows")
    if leader == name:
        raise InputError(f"{axis.where}: expected another axis to follow, got itself.")
    for key in ("tolerance_mm", "tolerance_rad"):
        if key in axis:
            return Follows(leader=leader, tolerance=axis.number(key, above=0.0))
    return Follows(leader=leader)


def _is_ignored(axis: YamlSection) -> bool:
    value = axis.values.get("ignored", False)
    if not isinstance(value, bool):
        raise InputError(f"{axis.where}: expected true or false for 'ignored', got {value!r}.")
    return value
