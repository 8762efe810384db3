"""The one state that every page shows: facts go in, a complete picture of now comes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Part
from omm_core.files.wishes import Jack
from omm_core.words import NOTHING, Words
from omm_operator.screen import pages, result
from omm_operator.screen.commands import Command
from omm_operator.screen.correcting import (
    correction_dict,
    corrections_in_all_modes,
    typed_jacks,
)
from omm_operator.screen.facts import (
    ControlFact,
    EstimateFact,
    FoundFact,
    HealthFact,
    OffsetFact,
    PictureFact,
)
from omm_operator.screen.handing import HandingOptions, Situation, conditions
from omm_operator.screen.history import History
from omm_operator.screen.troubles import Troubles
from omm_operator.screen.watch import SOURCES, Watch
from omm_report.language import Said, said_of, say

Array = NDArray[np.float64]
_ERROR = 2
# The line of /diagnostics that says how a station is; of the estimator, any line is a sign of life.
_DECISIVE = {"camera": "connection", "recorder": "recording"}
_TOLD_OTHERWISE = {*_DECISIVE.items(), ("estimator", "estimate"), ("cnc_bridge", "connection")}


@dataclass(kw_only=True)
class Kept:
    """What was heard last, and what was done."""

    estimate: EstimateFact | None = None
    control: ControlFact | None = None
    picture: PictureFact | None = None
    found: dict[int, FoundFact] = field(default_factory=dict)
    part: Part | None = None
    part_why: Words = NOTHING
    jacks: tuple[Jack, ...] = ()
    up: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    stops: int = 0
    commands_allowed: bool | None = None
    offset: OffsetFact | None = None
    handed: dict[str, Any] | None = None
    report: dict[str, Any] = field(default_factory=lambda: {"state": "none", "number": 0})


class Screen:
    """Everything that is heard, judged and shown. All of it is called from one thread.

    Parameters
    ----------
    options : HandingOptions
    stops : int
        Images that the measuring program takes; 0: not known, learned from its first whole run.
    wall_ns, clock_s : callable
        The time of day (ns), and a monotonic clock (s).
    """

    def __init__(
        self,
        *,
        options: HandingOptions,
        wall_ns: Callable[[], int],
        clock_s: Callable[[], float],
        stops: int = 0,
    ) -> None:
        self.options = options
        self.kept = Kept(stops=stops)
        self.troubles, self.history, self.watch = Troubles(), History(), Watch()
        self.changes = 0
        """Counts what is worth showing at once."""
        self._wall_ns, self._clock_s = wall_ns, clock_s
        self._sources: dict[str, str] = {}
        self._levels: dict[tuple[str, str], int] = {}
        self._told_images: set[int] = set()
        self._told_findings: set[str] = set()
        self._first_acknowledged = 0

    # --- facts ---------------------------------------------------------------------------------

    def take_control(self, fact: ControlFact) -> None:
        """Take what the bridge says of the control."""
        now_s, before = self._clock_s(), self.kept.control
        self.watch.hear("bridge", now_s)
        self.watch.hear("control", now_s, fine=fact.connected, detail=fact.detail)
        self.kept.control = fact
        if before is None or before.noteworthy() != fact.noteworthy():
            self.changes += 1
        if before is not None and before.program_word != fact.program_word:
            self._learn_stops(before, fact)

    def take_estimate(self, fact: EstimateFact) -> None:
        """Take an estimate; what is new in it and wrong goes into the list."""
        before = self.kept.estimate
        self.kept.estimate = fact
        self.changes += 1
        if before is not None and before.clamping != fact.clamping:
            self._told_images.clear()
            self._told_findings.clear()
        for image in fact.images:
            if image.refused and image.stamp_ns not in self._told_images:
                self._told_images.add(image.stamp_ns)
                self._trouble(
                    say(
                        "trouble.image",
                        number=_number(fact, image.stamp_ns),
                        of=len(fact.images),
                    ),
                    image.reason,
                )
        for finding in fact.findings:
            if finding not in self._told_findings:
                self._told_findings.add(finding)
                self._trouble(say("trouble.finding"), finding)
        if fact.revoked:
            self.kept.handed = None
        if fact.holds and fact.images_pending == 0:
            self.history.take(fact, result.rows(fact, self.kept.part))

    def take_health(self, fact: HealthFact) -> None:
        """Take a line of diagnostics: a sign of life, and news where it became an error."""
        if fact.node == "estimator":
            self.watch.hear(fact.node, self._clock_s())
        elif _DECISIVE.get(fact.node) == fact.name:
            fine = fact.level < _ERROR
            self.watch.hear(
                fact.node, self._clock_s(), fine=fine, detail="" if fine else fact.message
            )
        before = self._levels.get((fact.node, fact.name), 0)
        self._levels[(fact.node, fact.name)] = fact.level
        if fact.level >= _ERROR > before and (fact.node, fact.name) not in _TOLD_OTHERWISE:
            self._trouble(say("trouble.node", node=fact.node, name=fact.name), fact.message)
            self.changes += 1

    def take_picture(self, fact: PictureFact) -> None:
        """Take the newest picture."""
        self.kept.picture = fact
        self.changes += 1

    def take_found(self, fact: FoundFact) -> None:
        """Take what was found in an image; only of the newest few is it kept."""
        self.kept.found[fact.stamp_ns] = fact
        for stamp_ns in sorted(self.kept.found)[:-8]:
            del self.kept.found[stamp_ns]
        self.changes += 1

    def take_part_or_why(self, part: Part | Words) -> None:
        """Take the part file that is measured by, or why there is none."""
        self.kept.part = None if isinstance(part, str) else part
        self.kept.part_why = part if isinstance(part, str) else NOTHING
        if self.kept.part is not None and self.kept.part.jacks:
            self.kept.jacks = self.kept.part.jacks
        self.changes += 1

    def take_allowed(self, allowed: bool) -> None:
        """Take whether the bridge may command the control."""
        self.changes += allowed is not self.kept.commands_allowed
        self.kept.commands_allowed = allowed

    def lose(self, station: str) -> None:
        """Take that a node has left."""
        self.watch.lose(station)

    # --- judging -------------------------------------------------------------------------------

    def tick(self) -> bool:
        """Look at the time; True where a station fell silent, failed or came back since."""
        now_s, changed = self._clock_s(), False
        for name in SOURCES:
            source, before = self.watch.source(name, now_s), self._sources.get(name, "waiting")
            if source.state != before:
                changed = True
                self._sources[name] = source.state
                if source.state in ("silent", "fault"):
                    self._trouble(say(f"trouble.{source.state}_{name}"), source.detail)
        self.changes += changed
        return changed

    def refusal(self, command: Command) -> Said | None:
        """Return why a command cannot be carried out now; None where it can."""
        return self.refusals()[command.name] if command.name != "acknowledge" else None

    def refusals(self) -> Mapping[str, Said | None]:
        """Return by command why it cannot be carried out now."""
        now_s, kept = self._clock_s(), self.kept
        no_estimator = None if self.watch.well("estimator", now_s) else say("command.no_estimator")
        no_bridge = None if self.watch.well("bridge", now_s) else say("command.no_bridge")
        no_control = None if self.watch.well("control", now_s) else say("command.no_control")
        no_camera = None if self.watch.well("camera", now_s) else say("command.no_camera")
        running = kept.control is not None and kept.control.program_word in ("running", "waiting")
        busy = say("command.program_runs") if running else None
        unmet = next((c.why for c in self.conditions() if not c.holds), None)
        no_pose = None if kept.estimate and kept.estimate.holds else say("hand.no_pose")
        no_jacks = None if len(kept.jacks) >= 3 else say("correct.no_jacks")
        allowed = None if kept.commands_allowed else say("hand.not_allowed")
        makes = say("report.under_way") if kept.report["state"] == "under_way" else None
        no_recorder = None if self.watch.well("recorder", now_s) else say("command.no_recorder")
        return {
            "start_program": no_bridge
            or no_control
            or no_camera
            or no_estimator
            or busy
            or allowed,
            "new_clamping": no_estimator or busy,
            "corrected": no_estimator or busy or no_pose or no_jacks,
            "set_jacks": None,
            "hand_over": unmet or self._no_words(),
            "read_offset": no_bridge or no_control,
            "make_report": no_recorder or no_pose or makes,
        }

    def conditions(self) -> Sequence[Any]:
        """Return what must hold before the control is written to."""
        now_s = self._clock_s()
        situation = Situation(
            estimator_well=self.watch.well("estimator", now_s),
            bridge_well=self.watch.well("bridge", now_s),
            estimate=self.kept.estimate,
            control=self.kept.control,
            commands_allowed=self.kept.commands_allowed,
            now_ns=self._wall_ns(),
        )
        return conditions(situation, self.options)

    def _no_words(self) -> Said | None:
        hand = pages.hand_words(self.kept, self.options)
        return None if hand.wanted is not None else said_of(hand.why)

    # --- what commands change ------------------------------------------------------------------

    def corrected(self, mode: str) -> list[dict[str, Any]]:
        """Note that the jacks were turned as a mode shows them; return by how much."""
        estimate = self.kept.estimate
        assert estimate is not None  # `refusals` has looked
        found = corrections_in_all_modes(estimate, self.kept.part, self.kept.jacks, self.kept.up)
        turned = [
            {**correction_dict(c), "x_mm": float(j.xyz_mm[0]), "y_mm": float(j.xyz_mm[1])}
            for j, c in zip(self.kept.jacks, found[mode], strict=True)
        ]
        self.history.correct(mode, turned)
        self.changes += 1
        return turned

    def set_jacks(self, entries: object) -> None:
        """Take jacks as somebody typed them."""
        self.kept.jacks = typed_jacks(entries)
        self.changes += 1

    def acknowledge(self, number: int) -> bool:
        """Remove an error from the list, 0 for all; whether there was one."""
        self.changes += 1
        return self.troubles.acknowledge(number)

    def trouble(self, said: Said, detail: str = "") -> None:
        """Put something that went wrong into the list."""
        self._trouble(said, detail)
        self.changes += 1

    # --- what is shown -------------------------------------------------------------------------

    def snapshot(self) -> dict[str, Any]:
        """Return the whole state as pages get it."""
        now_s, now_ns = self._clock_s(), self._wall_ns()
        sources = [self.watch.source(name, now_s) for name in SOURCES]
        live = self.watch.well("estimator", now_s)
        return {
            "changes": self.changes,
            "time_ms": now_ns // 1_000_000,
            "sources": [pages.source_dict(source) for source in sources],
            "measure": pages.measure(self.kept),
            "result": pages.result_page(self.kept, self.history, live=live, now_ns=now_ns),
            "correct": pages.correct(self.kept, self.history),
            "hand": pages.hand(self.kept, self.options, self.conditions()),
            "troubles": pages.troubles(self.troubles),
            "report": dict(self.kept.report),
            "commands": {
                name: None if why is None else why.to_json_dict()
                for name, why in self.refusals().items()
            },
        }

    def _trouble(self, said: Said, detail: str) -> None:
        self.troubles.add(said, self._wall_ns(), said_of(detail) if detail else None)

    def _learn_stops(self, before: ControlFact, fact: ControlFact) -> None:
        """Count the images between a program's start and its end."""
        if before.program_word not in ("running", "waiting") and fact.program_word == "running":
            self._first_acknowledged = fact.measure_acknowledged
        if fact.program_word == "finished":
            taken = fact.measure_acknowledged - self._first_acknowledged
            self.kept.stops = taken if taken > 0 else fact.measure_acknowledged


def _number(estimate: EstimateFact, stamp_ns: int) -> int:
    """Return the number of an image, from 1 in the order of the stamps."""
    return 1 + sum(image.stamp_ns < stamp_ns for image in estimate.images)
