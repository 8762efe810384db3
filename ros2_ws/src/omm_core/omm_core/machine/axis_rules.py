"""What becomes of the axes that a control reports and the URDF lacks.

Each is in the URDF, follows another (second drive of a gantry), is ignored by name, or the pose is
refused: a quill or a turned table that nobody told us of would make a wrong pose that looks fine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from dataclasses import dataclass, field

from omm_core.errors import InputError
from omm_core.files.machine import Follows, Machine
from omm_core.words import NOTHING, Words, keyed, verbatim

FOLLOW_TOLERANCE = {False: 0.02, True: 2e-5}
"""How far two drives of one axis may be apart, mm and rad, where machine.yaml does not say."""


@dataclass(frozen=True, kw_only=True)
class AxisRules:
    """What machine.yaml says of axes that the URDF does not have."""

    follows: Mapping[str, Follows] = field(default_factory=dict)
    ignored: frozenset[str] = frozenset()

    @classmethod
    def of(cls, machine: Machine) -> AxisRules:
        """Return the rules that a machine's file gives."""
        return cls(follows=machine.follows, ignored=machine.ignored)

    def check(self, machine: str, moving: Set[str], turning: Mapping[str, bool]) -> None:
        """Raise InputError where a rule contradicts the URDF of a machine.

        Parameters
        ----------
        machine : str
            Its name, for messages.
        moving : set of str
            Axes that move spindle or part: an ignored one would move them unseen.
        turning : mapping
            Every axis of the URDF, and whether it turns.
        """
        if both := sorted(self.ignored & moving):
            raise InputError(
                f"Expected ignored axes to move neither spindle nor part, got {', '.join(both)},"
                f" which the URDF of {machine} has. Take it out of one of the two."
            )
        for axis, follows in self.follows.items():
            if follows.leader not in {*turning, *self.follows}:
                raise InputError(
                    f"Expected {axis} to follow an axis of the URDF of {machine}, got"
                    f" {follows.leader}; it has {', '.join(turning)}"
                    f"{_case_hint(follows.leader, turning)}."
                )
            turns = turning.get(follows.leader)
            if None not in (turns, follows.in_rad) and turns != follows.in_rad:
                raise InputError(
                    f"Expected tolerance_{'rad' if turns else 'mm'} of {axis}, as"
                    f" {follows.leader} {'turns' if turns else 'does not turn'}, got the other."
                )

    def refusal(
        self,
        positions: Mapping[str, float],
        unusable: Mapping[str, str],
        followers: Mapping[str, str],
        known: Mapping[str, bool],
    ) -> Words:
        """Return why no pose may be made of positions, naming the axis; empty where one may.

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
                return _with_way_out(
                    keyed("said.axis_unusable", "axis {axis}: {why}", axis=axis,
                          why=verbatim(unusable[axis])),
                    axis, known,
                )  # fmt: skip
            if axis in follows:
                apart = _apart(axis, follows[axis], positions, known)
                if apart:
                    return apart
            elif axis not in known:
                return _with_way_out(_not_in_urdf(axis, positions[axis]), axis, known)
        return NOTHING


def _apart(
    axis: str, follows: Follows, positions: Mapping[str, float], known: Mapping[str, bool]
) -> Words:
    leader = follows.leader
    if leader not in positions:
        return keyed(
            "said.no_leader",
            "axis {axis} follows {leader}, for which the control reports no position",
            axis=axis,
            leader=leader,
        )
    turns = known.get(leader, False)
    tolerance = FOLLOW_TOLERANCE[turns] if follows.tolerance is None else follows.tolerance
    apart = abs(positions[axis] - positions[leader])
    if math.isfinite(apart) and apart <= tolerance:
        return NOTHING
    unit = "rad" if turns else "mm"
    return keyed(
        "said.apart",
        "axis {axis} follows {leader} and is {apart} {unit} apart from it, more than {most} {unit}",
        axis=axis, leader=leader, apart=f"{apart:.4f}", unit=unit, most=f"{tolerance:g}",
    )  # fmt: skip


def _not_in_urdf(axis: str, at: float) -> Words:
    return keyed(
        "said.not_in_urdf",
        "axis {axis} is reported by the control (at {at}) and is not in the machine's URDF",
        axis=axis,
        at=f"{at:.4f}",
    )


def _with_way_out(words: Words, axis: str, known: Mapping[str, bool]) -> Words:
    """Return words with what to do about an axis that the machine does not know."""
    if axis in known:
        return words
    return keyed(
        "said.axis_way_out",
        "{what}: add it to the URDF, or to machine.yaml as {ignored} if it moves neither spindle"
        " nor part, or {follows} if it is a second drive",
        what=words,
        ignored=verbatim(f"{axis}: {{ignored: true}}"),
        follows=verbatim(f"{axis}: {{follows: …}}"),
    )


def _case_hint(name: str, known: Mapping[str, bool]) -> str:
    same = name.lower() in {other.lower() for other in known}
    return " (capital and small letters differ)" if same else ""
