"""From axis positions to the pose of the spindle, for any machine that a URDF describes.

The chain is ``machine_T_spindle(q) = machine_T_part_carrier(0) · part_carrier_T_spindle(q)``.
Seen from what carries the part, a table that moves is a spindle that moves the other way; so the
frame ``machine`` rides on the part's carrier and is the URDF's root where all table axes are zero.
Without table axes it is the root, always.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.machine import load_machine
from omm_core.geometry import RigidTransform
from omm_core.machine.axis_rules import AxisRules
from omm_core.machine.urdf import Joint, Robot, load_urdf
from omm_core.words import Words, keyed

Array = NDArray[np.float64]


class Side(Enum):
    """Whether an axis moves the tool or the part."""

    TOOL = "tool"
    PART = "part"


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One axis of the machine, as the control names it."""

    name: str
    rotary: bool
    side: Side
    lower: float
    """mm or rad; -inf where unlimited."""
    upper: float
    direction: tuple[float, float, float]
    """Unit vector in the joint's frame."""

    @property
    def unit(self) -> str:
        """The unit of the axis' position."""
        return "rad" if self.rotary else "mm"


class Kinematics:
    """Kinematics of one machine.

    Parameters
    ----------
    robot : Robot
        The URDF as read. Movable joints are the axes and bear the control's names for them.
    spindle, part_carrier : str
        Links whose relative pose is wanted. ``part_carrier`` is the root link where the URDF has no
        link of that name.
    rules : AxisRules
        What becomes of axes that a control reports besides.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        spindle: str = "spindle",
        part_carrier: str = "part_carrier",
        rules: AxisRules | None = None,
    ) -> None:
        self.rules = rules or AxisRules()
        self.name = robot.name
        self.robot = robot
        self._to_tool = robot.chain(spindle)
        self._to_part = robot.chain(part_carrier) if part_carrier in robot.links else ()
        common = 0
        for a, b in zip(self._to_tool, self._to_part):
            if a is not b:
                break
            common += 1
        if any(joint.movable for joint in self._to_tool[:common]):
            raise InputError(
                f"Expected axes of {robot.name} to move the spindle or the part, got "
                f"{self._to_tool[common - 1].name}, which moves both. Split the chain at its root."
            )
        tool = [_axis(j, Side.TOOL) for j in self._to_tool if j.movable]
        part = [_axis(j, Side.PART) for j in self._to_part if j.movable]
        self.axes: tuple[Axis, ...] = (*part, *tool)
        self.rotary = frozenset(a.name for a in self.axes if a.rotary)
        self.turning = {joint.name: joint.rotary for joint in robot.joints if joint.movable}
        """Every axis of the URDF, those that move neither tool nor part included: does it turn?"""
        if not self.axes:
            raise InputError(f"Expected axes between {spindle} and the part of {robot.name}.")
        self.rules.check(robot.name, {axis.name for axis in self.axes}, self.turning)
        zero = {axis.name: 0.0 for axis in self.axes}
        self._machine_T_carrier0 = _product(self._to_part, zero)

    @classmethod
    def load(cls, path: str | Path) -> Kinematics:
        """Read a URDF or a machine.yaml. Raises InputError where it describes no machine."""
        file = load_machine(path)
        robot = load_urdf(file.urdf)
        try:
            return cls(robot, rules=AxisRules.of(file))
        except InputError as error:
            raise InputError(f"{path}: {error}") from error

    def machine_T_spindle(self, axes: Mapping[str, float]) -> RigidTransform:
        """Return the spindle's pose from axis positions by name (mm, rad).

        Raises
        ------
        InputError
            Where a position is missing or not finite.
        """
        matrix = self._pose(self._checked(axes))
        return RigidTransform(rotation=matrix[:3, :3], translation_mm=matrix[:3, 3])

    def out_of_limits(self, axes: Mapping[str, float], slack: float = 1e-6) -> tuple[Words, ...]:
        """Describe the axes whose position lies outside what the machine can reach."""
        return tuple(
            keyed(
                "said.out_of_limits",
                "{axis} = {at} {unit} is outside {low} … {high}",
                axis=a.name,
                at=f"{axes[a.name]:.4f}",
                unit=a.unit,
                low=f"{a.lower:.4f}",
                high=f"{a.upper:.4f}",
            )
            for a in self.axes
            if a.name in axes and not a.lower - slack <= axes[a.name] <= a.upper + slack
        )

    def axes_at_tool_point(
        self,
        rotary: Mapping[str, float],
        p_tool_mm: Array,
        tool_length_mm: float,
        *,
        turns_with_part: bool = False,
    ) -> dict[str, float]:
        """Return the axis positions of a control that reports its tool point instead.

        The tool point is that of RTCP, TCPM or G43.4.

        The tool point is an affine function of the three linear axes; this solves it.

        Parameters
        ----------
        rotary : mapping
            Positions of the rotary axes, rad.
        p_tool_mm : (3,) array
            The tool point that the control reports.
        tool_length_mm : float
            Distance from the spindle's origin to the tool point, against the spindle's z.
        turns_with_part : bool
            Whether the control gives the point in coordinates that move with the table (the frame
            ``machine`` of this module) or in those of the standing machine.

        Raises
        ------
        InputError
            Where the machine does not have three independent linear axes.
        """
        linear = [axis.name for axis in self.axes if not axis.rotary]
        held = {name: rotary[name] for name in self.rotary if name in rotary}

        def point(values: Array) -> Array:
            axes = self._checked({**held, **dict(zip(linear, values.tolist(), strict=True))})
            pose = self._pose(axes) if turns_with_part else _product(self._to_tool, axes)
            return np.asarray(pose[:3, 3] - tool_length_mm * pose[:3, 2])

        start = np.zeros(len(linear))
        p0 = point(start)
        steps = np.array([point(np.eye(len(linear))[i]) - p0 for i in range(len(linear))])
        if steps.shape != (3, 3) or abs(np.linalg.det(steps)) < 1e-6:
            raise InputError(
                f"Expected three independent linear axes to find the tool point, {self.name} has "
                f"{', '.join(linear) or 'none'}. Have the control report its axes instead."
            )
        solved = np.linalg.solve(steps.T, np.asarray(p_tool_mm, dtype=float) - p0)
        return {**held, **dict(zip(linear, solved.tolist(), strict=True))}

    def _checked(self, axes: Mapping[str, float]) -> Mapping[str, float]:
        for axis in self.axes:
            value = axes.get(axis.name)
            if value is None or not math.isfinite(value):
                raise InputError(
                    f"Expected a position of axis {axis.name} of {self.name}, got {value}. The "
                    f"control reports {', '.join(axes) or 'no axes'}; the URDF's joints must have"
                    f" these names."
                )
        return axes

    def _pose(self, axes: Mapping[str, float]) -> Array:
        tool = _product(self._to_tool, axes)
        if not self._to_part:
            return tool
        part = _product(self._to_part, axes)
        return np.asarray(self._machine_T_carrier0 @ _inverse(part) @ tool)


def _product(chain: tuple[Joint, ...], axes: Mapping[str, float]) -> Array:
    """Return the homogeneous root_T_link of a chain of joints, (4, 4), mm."""
    matrix = np.eye(4)
    for joint in chain:
        matrix = matrix @ joint.origin
        if joint.movable:
            matrix = matrix @ _motion(joint, axes[joint.name])
    return matrix


def _motion(joint: Joint, value: float) -> Array:
    """Return the homogeneous motion of one joint: a shift, or a turn by Rodrigues' formula."""
    motion = np.eye(4)
    if not joint.rotary:
        motion[:3, 3] = value * joint.axis
        return motion
    x, y, z = joint.axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    motion[:3, :3] += math.sin(value) * cross + (1.0 - math.cos(value)) * (cross @ cross)
    return motion


def _inverse(matrix: Array) -> Array:
    inverse = np.eye(4)
    inverse[:3, :3] = matrix[:3, :3].T
    inverse[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return inverse


def _axis(joint: Joint, side: Side) -> Axis:
    x, y, z = joint.axis.tolist()
    return Axis(
        name=joint.name,
        rotary=joint.rotary,
        side=side,
        lower=joint.lower,
        upper=joint.upper,
        direction=(x, y, z),
    )
