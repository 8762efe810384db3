"""What becomes of the axes that a control reports and the URDF lacks.

Each is in the URDF, follows another (second drive of a gantry), is ignored by name, or the pose is
refused: a quill or a turned table that nobody told us of would make a wrong pose that looks fine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection

FOLLOW_TOLERANCE = {False: 0.02, True: 2e-5}
"""How far two drives of one axis may be apart, mm and rad, where machine.yaml does not say."""


@dataclass(frozen=True, kw_only=True)
class Follows:
    """An axis that goes with another one."""

    leader: str
    tolerance: float | None = None
    """mm, or rad where the leader turns; None takes FOLLOW_TOLERANCE."""


@dataclass(frozen=True, kw_only=True)
class AxisRules:
    """What machine.yaml says of axes that the URDF does not have."""

    follows: Mapping[str, Follows] = field(default_factory=dict)
    ignored: frozenset[str] = frozenset()

    def refusal(
        self,
        positions: Mapping[str, float],
        unusable: Mapping[str, str],
        followers: Mapping[str, str],
        known: Mapping[str, bool],
    ) -> str:
        """Say why no pose may be made of positions, naming the axis; empty where one may.

        Parameters
        ----------
        positions, unusable, followers : mapping
            As a ControlSample has them.
        known : mapping
            Axes that a pose is made of, and whether each turns.
        """
        follows = {axis: Follows(leader=leader) for axis, leader in followers.items()}
        follows |= self.follows
        for axis in (*unusable, *positions):
            if axis in self.ignored:
                continue
            if axis in unusable:
                return f"axis {axis}: {unusable[axis]}{_way_out(axis, known)}"
            if axis in follows:
                apart = _apart(axis, follows[axis], positions, known)
                if apart:
                    return apart
            elif axis not in known:
                return (
                    f"axis {axis} is reported by the control (at {positions[axis]:.4f}) and "
                    f"is not in the machine's URDF{_way_out(axis, known)}"
                )
        return ""


def read_machine_file(path: Path) -> tuple[Path, AxisRules]:
    """Path of the URDF, and the rules for other axes, of a URDF or a machine.yaml.

    The two are told apart by content: a URDF is XML.

    Raises
    ------
    InputError
        Where the file cannot be read or its axes say something else than the contract has.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        return path, AxisRules()  # XML declares its own encoding
    except OSError as error:
        raise InputError(
            f"Expected a machine (URDF or machine.yaml) at {path}: {error.strerror}."
        ) from error
    if text.lstrip().startswith("<"):
        return path, AxisRules()
    try:
        root = YamlSection(yaml.safe_load(text), str(path))
    except yaml.YAMLError as error:
        raise InputError(f"{path}: expected a URDF (XML) or a machine.yaml: {error}") from error
    urdf = path.parent / root.section("machine").text("urdf")
    return urdf, _rules(root)


def _rules(root: YamlSection) -> AxisRules:
    if "axes" not in root:
        return AxisRules()
    axes = root.section("axes")
    follows: dict[str, Follows] = {}
    ignored: set[str] = set()
    for name in axes.values:
        if name not in axes:  # "X:" with nothing behind it
            continue
        axis = axes.section(name)
        if "follows" in axis:
            follows[str(name)] = _follows(str(name), axis)
        if _is_ignored(axis):
            ignored.add(str(name))
    both = sorted(ignored & {*follows, *(f.leader for f in follows.values())})
    if both:
        raise InputError(
            f"{axes.where}: expected {', '.join(both)} to be ignored or to follow, got both."
        )
    return AxisRules(follows=follows, ignored=frozenset(ignored))


def _follows(name: str, axis: YamlSection) -> Follows:
    leader = axis.text("follows")
    if leader == name:
        raise InputError(f"{axis.where}: expected another axis to follow, got itself.")
    for key in ("tolerance_mm", "tolerance_rad"):
        if key in axis:
            return Follows(leader=leader, tolerance=axis.number(key, above=0.0))
    return Follows(leader=leader)


def _is_ignored(axis: YamlSection) -> bool:
    value: Any = axis.values.get("ignored", False)
    if not isinstance(value, bool):
        raise InputError(f"{axis.where}: expected true or false for 'ignored', got {value!r}.")
    return value


def _apart(
    axis: str, follows: Follows, positions: Mapping[str, float], known: Mapping[str, bool]
) -> str:
    leader = follows.leader
    if leader not in positions:
        return f"axis {axis} follows {leader}, of which the control reports no position"
    turns = known.get(leader, False)
    tolerance = FOLLOW_TOLERANCE[turns] if follows.tolerance is None else follows.tolerance
    apart = abs(positions[axis] - positions[leader])
    if math.isfinite(apart) and apart <= tolerance:
        return ""
    unit = "rad" if turns else "mm"
    return (
        f"axis {axis} follows {leader} and is {apart:.4f} {unit} apart from it, more than "
        f"{tolerance:g} {unit}"
    )


def _way_out(axis: str, known: Mapping[str, bool]) -> str:
    if axis in known:
        return ""
    return (
        f": add it to the URDF, or to machine.yaml as {axis}: {{ignored: true}} if it moves "
        f"neither spindle nor part, or {axis}: {{follows: …}} if it is a second drive"
    )
