"""Whether the pose may go to the control now, and in which words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from omm_core.alignment.controls import CONTROLS, control_and_number
from omm_core.alignment.handover import Box, Handover, hand_over
from omm_core.errors import OmmError
from omm_core.files.part import Part
from omm_core.words import NOTHING, Words, of_error
from omm_operator.screen.facts import ControlFact, EstimateFact, OffsetFact
from omm_report.language import Said, say

# Controls of which the bridge writes offsets, and whose words their numbers are.
LIVE = {"linuxcnc": "linuxcnc", "simulated": "linuxcnc", "opcua": ""}
READ_BACK_MM = 1e-4
READ_BACK_RAD = 1e-8
_MOVING_PROGRAMS = ("running", "waiting", "interrupted")


@dataclass(frozen=True, kw_only=True)
class Condition:
    """One thing that must hold before the control is written to; ``why`` where it does not."""

    name: str
    holds: bool
    why: Said | None = None


@dataclass(frozen=True, kw_only=True)
class HandingOptions:
    """Which control's words, which of its offsets, and what may remain."""

    control: str = ""
    offset: str = ""
    remaining_mm: float = 0.1
    fresh_s: float = 3600.0

    def check(self) -> None:
        """Raise InputError where the offset is none of the chosen control's."""
        if self.control and self.offset:
            control_and_number(self.control, self.offset)

    def words_of(self, live_control: str) -> str:
        """Return whose words are shown: as chosen, else those of the control that is there."""
        return self.control or LIVE.get(live_control, "") or "linuxcnc"

    def offset_of(self, words: str) -> str:
        """Return the offset's name, the control's first where none was chosen."""
        return self.offset or CONTROLS[words].offset


@dataclass(frozen=True, kw_only=True)
class Situation:
    """All that decides whether the control may be written to."""

    estimator_well: bool
    bridge_well: bool
    estimate: EstimateFact | None
    control: ControlFact | None
    commands_allowed: bool | None
    now_ns: int


def conditions(situation: Situation, options: HandingOptions) -> tuple[Condition, ...]:
    """Return everything that must hold, in the order in which a person would look."""
    estimate, control = situation.estimate, situation.control
    holds = estimate is not None and estimate.holds
    age_s = (situation.now_ns - estimate.stamp_ns) / 1e9 if estimate is not None else np.inf
    fresh = situation.estimator_well and holds and -5.0 <= age_s <= options.fresh_s
    judged = holds and estimate is not None and estimate.images_pending == 0
    connected = situation.bridge_well and control is not None and control.connected
    at_rest = connected and control is not None and control.in_position
    idle = connected and control is not None and control.program_word not in _MOVING_PROGRAMS
    takes = control is not None and control.control in LIVE
    return (
        _condition("pose", holds, "hand.no_pose"),
        _condition("judged", judged, "hand.not_judged"),
        _condition("fresh", fresh, "hand.not_fresh"),
        _condition("connected", connected, "hand.not_connected"),
        _condition("takes", takes, "hand.takes_no_offset"),
        _condition("allowed", situation.commands_allowed is True, "hand.not_allowed"),
        _condition("at_rest", at_rest, "hand.not_at_rest"),
        _condition("idle", idle, "hand.program_runs"),
    )


def words_for(
    estimate: EstimateFact, part: Part | None, words: str, offset: str, remaining_mm: float
) -> Handover:
    """Return the pose in a control's own words.

    Raises
    ------
    InputError
        Where the control or its offset is not known.
    MeasurementError
        Where the words cannot say the pose.
    """
    more = {} if part is None else {"box": _box(part)}
    return hand_over(
        estimate.machine_T_part(),
        words,
        offset=offset,
        remaining_mm=remaining_mm,
        title=f"part {estimate.part}, measured live",
        **more,
    )


def handover_or_why(
    estimate: EstimateFact, part: Part | None, words: str, options: HandingOptions
) -> tuple[Handover | None, Words]:
    """Return the words, or why there are none."""
    try:
        return words_for(
            estimate, part, words, options.offset_of(words), options.remaining_mm
        ), NOTHING
    except OmmError as error:
        return None, of_error(error)


def offset_to_write(
    estimate: EstimateFact, handover: Handover | None, live_control: str, name: str
) -> OffsetFact | None:
    """Return the numbers for the control: its rounded words, or the pose where nodes hold it."""
    if live_control == "opcua":
        pose = estimate.machine_T_part()
    elif handover is not None:
        pose = handover.words.said
    else:
        return None
    x, y, z = (float(value) for value in pose.translation_mm)
    a, b, c = (float(angle) for angle in pose.euler_xyz_rad())
    return OffsetFact(name=name, xyz_mm=(x, y, z), euler_xyz_rad=(a, b, c))


def same_offset(wanted: OffsetFact, read: OffsetFact) -> bool:
    """Return whether the offset read back is the one written, to the control's last digit."""
    moved = np.subtract(wanted.xyz_mm, read.xyz_mm)
    turned = np.subtract(wanted.euler_xyz_rad, read.euler_xyz_rad)
    turned = np.remainder(turned + np.pi, 2.0 * np.pi) - np.pi
    return bool(
        wanted.name == read.name
        and np.all(np.abs(moved) <= READ_BACK_MM)
        and np.all(np.abs(turned) <= READ_BACK_RAD)
    )


def offset_dict(offset: OffsetFact | None) -> Mapping[str, object] | None:
    """Return what a page shows of an offset: mm and degrees."""
    if offset is None:
        return None
    return {
        "name": offset.name,
        "xyz_mm": list(offset.xyz_mm),
        "angles_deg": np.degrees(offset.euler_xyz_rad).tolist(),
    }


def _box(part: Part) -> Box:
    low, high = part.box()
    source = "box_mm of the part file" if part.box_mm is not None else "the box of its targets"
    return Box(low_mm=low, high_mm=high, source=source)


def _condition(name: str, holds: bool, why: str) -> Condition:
    return Condition(name=name, holds=holds, why=None if holds else say(why))
