"""Checks a machine's description against ISO 841: directions, handedness, order, limits.

Controls exist that deviate on purpose; what is found is said, not refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.machine.kinematics import Axis, Kinematics

_ABOUT = {"A": "X", "B": "Y", "C": "Z"}
_UNIT = {"X": np.eye(3)[0], "Y": np.eye(3)[1], "Z": np.eye(3)[2]}
_SMALL = 1e-6


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was looked at."""

    good: bool
    text: str


def motion_of(machine: Kinematics, axis: Axis) -> NDArray[np.float64]:
    """Return how the part sees the spindle move, per mm or rad of one axis at zero.

    Returns
    -------
    (3,) array
        Direction of the shift of a linear axis; axis vector of the turn of a rotary one.
    """
    zero = {a.name: 0.0 for a in machine.axes}
    before = machine.machine_T_spindle(zero)
    after = machine.machine_T_spindle({**zero, axis.name: _SMALL if axis.rotary else 1.0})
    if not axis.rotary:
        return np.asarray(after.translation_mm - before.translation_mm)
    turn = after.rotation @ before.rotation.T
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return np.asarray(vector / (2.0 * _SMALL))


def check(machine: Kinematics) -> tuple[Finding, ...]:
    """Return all findings, good ones included."""
    findings = [_direction(machine, axis) for axis in machine.axes]
    findings += [_limits(axis) for axis in machine.axes]
    return (*findings, _handedness(machine), _order(machine))


def _direction(machine: Kinematics, axis: Axis) -> Finding:
    letter = axis.name[:1].upper()
    expected = _UNIT.get(_ABOUT.get(letter, "") if axis.rotary else letter)
    what = "turns" if axis.rotary else "moves"
    motion = motion_of(machine, axis)
    told = _words(motion)
    if expected is None:
        return Finding(good=True, text=f"+{axis.name} {what} the tool {told}, as the part sees it")
    cosine = float(motion @ expected)
    if cosine > math.cos(math.radians(1.0)):
        return Finding(good=True, text=f"+{axis.name} {what} the tool {told}, as ISO 841 has it")
    hint = " Negate the joint's axis if the machine is not so." if cosine < -0.5 else ""
    name = _words(expected)
    return Finding(good=False, text=f"+{axis.name} {what} the tool {told}, ISO 841: {name}.{hint}")


def _limits(axis: Axis) -> Finding:
    scale, unit = (math.degrees(1.0), "°") if axis.rotary else (1.0, " mm")
    travel = f"{axis.name} from {axis.lower * scale:g}{unit} to {axis.upper * scale:g}{unit}"
    if axis.rotary and 100.0 < axis.upper - axis.lower < math.inf:
        return Finding(good=False, text=f"{travel}: more than 100 rad. Are the limits in rad?")
    if not axis.rotary and axis.upper - axis.lower > 50_000.0:
        return Finding(good=False, text=f"{travel}: more than 50 m. Are the limits in m?")
    if not axis.lower <= 0.0 <= axis.upper:
        return Finding(good=False, text=f"{travel}: zero is outside.")
    return Finding(good=True, text=travel)


def _handedness(machine: Kinematics) -> Finding:
    linear = {a.name: motion_of(machine, a) for a in machine.axes if not a.rotary}
    if not {"X", "Y", "Z"} <= set(linear):
        return Finding(good=True, text=f"no X, Y, Z to judge a handedness by: {', '.join(linear)}")
    determinant = float(np.linalg.det([linear[name] for name in "XYZ"]))
    good = abs(determinant - 1.0) < 1e-3
    say = "right-handed and square" if good else f"not right-handed and square ({determinant:.4f})"
    return Finding(good=good, text=f"X, Y, Z are {say}")


def _order(machine: Kinematics) -> Finding:
    chains = " · ".join(
        f"{side}: {' → '.join(a.name for a in machine.axes if a.side.value == side) or 'fixed'}"
        for side in ("part", "tool")
    )
    return Finding(good=True, text=f"order from the root, {chains}")


def _words(direction: NDArray[np.float64]) -> str:
    i = int(np.argmax(np.abs(direction)))
    if abs(abs(direction[i]) - 1.0) < 1e-3:
        return ("+" if direction[i] > 0 else "-") + "XYZ"[i]
    return f"({', '.join(f'{v:.3f}' for v in direction)})"
