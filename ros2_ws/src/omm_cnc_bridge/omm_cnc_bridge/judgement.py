"""Which samples of a control become poses. What this refuses is what the bridge is worth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from omm_cnc_bridge.control import ControlSample
from omm_cnc_bridge.standstill import StandStill, StandStillLimits
from omm_core.errors import InputError
from omm_core.geometry import RigidTransform
from omm_core.machine.kinematics import Kinematics
from omm_core.words import Words, keyed, of_error, verbatim


class Reported(Enum):
    """What the positions of a control are."""

    AXES = "axes"
    TOOL_POINT = "tool_point"
    """X, Y, Z are the tool point in the standing machine (RTCP), the others are axes."""
    TOOL_POINT_ON_PART = "tool_point_on_part"
    """The same, in coordinates that turn with the table."""


@dataclass(frozen=True, kw_only=True)
class SampleLimits:
    """What a sample must fulfil to become a pose."""

    age_ns: int = 500_000_000
    """Largest age on arrival."""
    stamp_uncertainty_ns: int = 10_000_000
    """Largest standard deviation of a stamp."""


@dataclass(frozen=True, kw_only=True)
class JudgedSample:
    """What came of one sample."""

    sample: ControlSample
    axes: Mapping[str, float]
    """Axis positions, mm or rad; found from the tool point where the control reports that."""
    machine_T_spindle: RigidTransform | None
    refused: Words
    """Why there is no pose; empty where there is one."""
    moving_reason: Words
    """Why the spindle is not known to stand still; empty where it is."""
    rest_since_ns: int | None
    age_ns: int


class Judge:
    """Judges the samples of one control, in the order in which they arrive."""

    def __init__(
        self,
        machine: Kinematics,
        still: StandStillLimits,
        limits: SampleLimits,
        *,
        reported: Reported = Reported.AXES,
        tool_length_mm: float = 0.0,
    ) -> None:
        self.machine = machine
        self._still = StandStill(still, machine.rotary)
        self._tolerances = {False: still.tolerance_mm, True: still.tolerance_rad}
        self._limits = limits
        self._reported = reported
        self._tool_length_mm = tool_length_mm
        self._last_ns = 0
        self.refusals: Counter[str] = Counter()
        """How many samples were refused for what."""

    def judge(self, sample: ControlSample, now_ns: int) -> JudgedSample:
        """Make a pose of a sample, or say why not."""
        age_ns = now_ns - sample.stamp_ns
        refused = self._refused(sample, age_ns)
        pose, axes = None, sample.positions
        if not refused:
            try:
                own = self._own(sample.positions)
                axes = self._axes(own)
                pose = self.machine.machine_T_spindle(axes)
            except InputError as error:
                refused = of_error(error)
                self.refusals["kinematics"] += 1
        if refused:
            self._still.forget()  # nothing is known of the time that it stood for
        else:
            self._last_ns = sample.stamp_ns
        moving = refused or self._still.update(self._seen(sample))
        return JudgedSample(
            sample=sample,
            axes=axes,
            machine_T_spindle=pose,
            refused=refused,
            moving_reason=moving,
            rest_since_ns=None if moving else self._still.since_ns,
            age_ns=age_ns,
        )

    def forget(self) -> None:
        """Start anew, as after a lost connection."""
        self._still.forget()

    def _refused(self, sample: ControlSample, age_ns: int) -> Words:
        if sample.fault:
            self.refusals["fault"] += 1
            return verbatim(sample.fault)
        if sample.stamp_ns <= self._last_ns:
            self.refusals["out of order"] += 1
            return keyed(
                "said.out_of_order",
                "stamp not after the one before ({ns} ns)",
                ns=sample.stamp_ns - self._last_ns,
            )
        if sample.stamp_uncertainty_ns > self._limits.stamp_uncertainty_ns:
            self.refusals["clock uncertain"] += 1
            return keyed(
                "said.clock_uncertain",
                "the control's clock is known to {ms} ms only, wait",
                ms=f"{sample.stamp_uncertainty_ns / 1e6:.1f}",
            )
        if age_ns > self._limits.age_ns:
            self.refusals["late"] += 1
            return keyed("said.late", "late by {s} s", s=f"{age_ns / 1e9:.3f}")
        if age_ns < -self._limits.stamp_uncertainty_ns:
            self.refusals["future"] += 1
            return keyed(
                "said.in_the_future", "stamped {s} s in the future", s=f"{-age_ns / 1e9:.3f}"
            )
        refusal = self.machine.rules.refusal(
            sample.positions,
            {**self._of_another_kind(sample), **self._hidden(sample), **sample.unusable},
            sample.followers,
            self._known(),
        )
        if refusal:
            self.refusals["axis"] += 1
        return refusal

    def _of_another_kind(self, sample: ControlSample) -> dict[str, str]:
        """Return why axes cannot be those of the URDF: a length is no angle, nor the reverse."""
        words = {False: "as a length", True: "as an angle"}
        known = self._known()
        return {
            axis: f"the control tells it {words[turns]}, the machine's URDF has it "
            f"{words[known[axis]]}"
            for axis, turns in sample.turning.items()
            if axis in sample.positions and known.get(axis, turns) != turns
        }

    def _hidden(self, sample: ControlSample) -> dict[str, str]:
        """Return the axes that may have moved unseen by more than an axis at rest may."""
        told: dict[str, str] = {}
        for axis, unseen in sample.unseen.items():
            turns = sample.turning.get(axis, False)
            most = self._tolerances[turns]
            late_ns = 1e9 * unseen.seconds / math.sqrt(3.0)
            if not unseen.distance <= most:
                name, unit = ("tolerance_rad", "rad") if turns else ("tolerance_mm", "mm")
                told[axis] = (
                    f"may have moved by {unseen.distance:g} {unit} unseen ({unseen.why}), more than"
                    f" {name} = {most:g}; have it told unfiltered, or raise {name}"
                )
            elif not late_ns <= self._limits.stamp_uncertainty_ns:
                told[axis] = (
                    f"may have moved for {unseen.seconds:g} s unseen ({unseen.why}), too long for"
                    f" max_stamp_uncertainty_s = {self._limits.stamp_uncertainty_ns / 1e9:g}; have"
                    " it told unfiltered"
                )
        return told

    def _known(self) -> dict[str, bool]:
        """Return the names that positions may have, and whether each turns."""
        if self._reported is Reported.AXES:
            return self.machine.turning
        return dict.fromkeys(("X", "Y", "Z"), False) | self.machine.turning

    def _own(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return the axes that the spindle's pose is made of."""
        known = self._known()
        return {axis: value for axis, value in positions.items() if axis in known}

    def _seen(self, sample: ControlSample) -> ControlSample:
        """Return the sample without the ignored axes, which may move while the spindle stands."""
        ignored = self.machine.rules.ignored
        if not ignored:
            return sample
        return replace(
            sample,
            positions={a: v for a, v in sample.positions.items() if a not in ignored},
            commanded={a: v for a, v in sample.commanded.items() if a not in ignored},
        )

    def _axes(self, positions: Mapping[str, float]) -> Mapping[str, float]:
        if self._reported is Reported.AXES:
            return positions
        try:
            p_tool_mm = np.array([positions[name] for name in ("X", "Y", "Z")])
        except KeyError as error:
            raise InputError(f"Expected the tool point as X, Y, Z; {error} is missing.") from error
        return self.machine.axes_at_tool_point(
            positions,
            p_tool_mm,
            self._tool_length_mm,
            turns_with_part=self._reported is Reported.TOOL_POINT_ON_PART,
        )
