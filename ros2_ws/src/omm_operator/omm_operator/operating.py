"""The operator's part, without ROS: the screen, the commands, and when pages are shown what.

All of it runs in the server's thread.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine
from typing import Any, Protocol

from omm_core.alignment.controls import CONTROLS
from omm_core.errors import OmmError
from omm_core.words import keyed, of_error
from omm_operator.screen import pages
from omm_operator.screen.commands import Command
from omm_operator.screen.desk import Answer, Desk, Record
from omm_operator.screen.facts import OffsetFact
from omm_operator.screen.handing import offset_dict, same_offset, words_for
from omm_operator.screen.screen import Screen
from omm_report.language import Said, said_of, say

TICK_S, SHOW_S = 0.1, 0.5
OFFSET_PERIOD_S = 5.0  # somebody may change it at the control
# What happens together is shown together.
TOGETHER_S = 0.03
_SUFFIXES = {"linuxcnc": "ngc", "siemens": "mpf", "heidenhain": "txt", "fanuc": "nc", "fagor": "nc"}


class Refused(OmmError):
    """A node did not do what it was asked, and said why."""


class Actions(Protocol):
    """What commands have others do. Each raises Refused with the reason where it was not done."""

    async def start_program(self) -> None:
        """Let the control start its measuring program."""

    async def new_clamping(self) -> None:
        """Let the estimator forget all images."""

    async def work_offset(self, name: str, wanted: OffsetFact | None) -> OffsetFact:
        """Return a work offset as the control has it, after writing it where one is given."""

    async def report(self, language: str) -> bytes:
        """Return the measurement so far as PDF."""


class Operation:
    """Everything behind the page.

    Parameters
    ----------
    screen : Screen
    actions : Actions
    record : Record
        Takes down commands and their answers.
    """

    def __init__(self, screen: Screen, actions: Actions, record: Record) -> None:
        self.screen = screen
        self.desk = Desk(screen.refusal, self._carry, record)
        self._actions = actions
        self._report: bytes | None = None
        self._looking_on: Callable[[], None] = lambda: None
        self._shown, self._due = -1, False
        self._offset_due_s = 0.0
        self._tasks: set[asyncio.Task[None]] = set()
        self._carriers = {
            "start_program": self._start_program,
            "new_clamping": self._new_clamping,
            "corrected": self._corrected,
            "set_jacks": self._set_jacks,
            "hand_over": self._hand_over,
            "read_offset": self._read_offset,
            "make_report": self._make_report,
            "acknowledge": self._acknowledge,
        }

    # --- showing -------------------------------------------------------------------------------

    def show_with(self, show: Callable[[], None]) -> None:
        """Show through a function from now on: after every change, and twice a second."""
        self._looking_on = show
        asyncio.get_running_loop().call_later(TICK_S, self._tick, 0.0)

    def take(self, take: Callable[[Any], None], fact: object) -> None:
        """Pass a fact to the screen, and show what it changed."""
        take(fact)
        self.show_soon()

    def show_soon(self) -> None:
        """Show what changed, together with what arrives in the next moment."""
        if not self._due and self.screen.changes != self._shown:
            self._due = True
            asyncio.get_running_loop().call_later(TOGETHER_S, self._show)

    def _tick(self, since_s: float) -> None:
        self.screen.tick()
        self._look_at_the_offset()
        since_s += TICK_S
        if since_s >= SHOW_S:
            self._show()
            since_s = 0.0
        else:
            self.show_soon()
        asyncio.get_running_loop().call_later(TICK_S, self._tick, since_s)

    def _look_at_the_offset(self) -> None:
        """Keep up with the control's offset, so that what would change stands there beforehand."""
        now_s = asyncio.get_running_loop().time()
        if self.screen.refusals()["read_offset"] is not None:
            self.screen.kept.offset = None
        elif now_s >= self._offset_due_s:
            self._offset_due_s = now_s + OFFSET_PERIOD_S
            self._in_the_background(self._reading_the_offset())

    async def _reading_the_offset(self) -> None:
        told = pages.hand_words(self.screen.kept, self.screen.options)
        with contextlib.suppress(Refused):  # a control may tell it only of the active offset
            self.screen.kept.offset = await self._actions.work_offset(told.offset, None)

    def _in_the_background(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _show(self) -> None:
        self._due, self._shown = False, self.screen.changes
        self._looking_on()

    # --- content of the server -----------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """Return the whole state."""
        return self.screen.snapshot()

    def picture(self) -> bytes | None:
        """Return the newest picture as JPEG."""
        picture = self.screen.kept.picture
        return picture.jpeg if picture else None

    def handover_file(self, control: str) -> tuple[str, str] | None:
        """Return name and text of a file for a control; None where there is no pose to say."""
        kept, options = self.screen.kept, self.screen.options
        if control not in CONTROLS or kept.estimate is None or not kept.estimate.holds:
            return None
        chosen = options.words_of(kept.control.control if kept.control else "") == control
        offset = options.offset_of(control) if chosen else CONTROLS[control].offset
        try:
            made = words_for(kept.estimate, kept.part, control, offset, options.remaining_mm)
        except OmmError:
            return None
        return f"omm-{control}.{_SUFFIXES[control]}", made.text

    def report_file(self) -> bytes | None:
        """Return the newest report as PDF."""
        return self._report

    # --- commands ------------------------------------------------------------------------------

    async def _carry(self, command: Command) -> Answer:
        """Carry out a command; a refusal stays in the list of troubles."""
        more: dict[str, Any] = {}
        try:
            said = await self._carriers[command.name](command, more)
        except OmmError as error:
            self.screen.trouble(say(f"trouble.refused_{command.name}"), of_error(error))
            self.show_soon()
            return Answer(accepted=False, said=said_of(of_error(error)))
        self.screen.changes += 1
        self.show_soon()
        return Answer(accepted=True, said=said, more=more)

    async def _start_program(self, command: Command, more: dict[str, Any]) -> Said:
        await self._actions.start_program()
        return say("done.start_program")

    async def _new_clamping(self, command: Command, more: dict[str, Any]) -> Said:
        await self._actions.new_clamping()
        return say("done.new_clamping")

    async def _corrected(self, command: Command, more: dict[str, Any]) -> Said:
        # First: what is shown now is what was turned, and it is gone with the clamping.
        more["jacks"] = self.screen.corrected(command.arguments["mode"])
        await self._actions.new_clamping()
        return say("done.corrected")

    async def _set_jacks(self, command: Command, more: dict[str, Any]) -> Said:
        self.screen.set_jacks(command.arguments["jacks"])
        return say("done.set_jacks")

    async def _acknowledge(self, command: Command, more: dict[str, Any]) -> Said:
        self.screen.acknowledge(command.arguments["number"])
        return say("done.acknowledge")

    async def _read_offset(self, command: Command, more: dict[str, Any]) -> Said:
        told = pages.hand_words(self.screen.kept, self.screen.options)
        self.screen.kept.offset = await self._actions.work_offset(told.offset, None)
        return say("done.read_offset")

    async def _hand_over(self, command: Command, more: dict[str, Any]) -> Said:
        """Write the offset, read it back, and compare."""
        kept = self.screen.kept
        wanted = pages.hand_words(kept, self.screen.options).wanted
        assert wanted is not None  # `refusals` has looked
        old = kept.offset
        with contextlib.suppress(Refused):  # a control may tell it only of the active offset
            old = await self._actions.work_offset(wanted.name, None)
        if self.screen.refusals()["hand_over"] is not None:
            raise Refused(
                keyed("said.changed_meanwhile", "Something changed meanwhile: nothing was written.")
            )
        read = await self._actions.work_offset(wanted.name, wanted)
        equal = same_offset(wanted, read)
        kept.offset = read
        more.update(old=offset_dict(old), new=offset_dict(wanted), read=offset_dict(read))
        kept.handed = {
            "time_ms": self.screen.snapshot()["time_ms"],
            "old": offset_dict(old),
            "new": offset_dict(wanted),
            "read": offset_dict(read),
            "equal": equal,
        }
        if not equal:
            raise Refused(
                keyed(
                    "said.reads_other",
                    "The control reads back something other than what was written.",
                )
            )
        return say("done.hand_over", offset=wanted.name)

    async def _make_report(self, command: Command, more: dict[str, Any]) -> Said:
        """Begin a report; it is ready when the state says so."""
        report = self.screen.kept.report
        self.screen.kept.report = {"state": "under_way", "number": report["number"]}
        language = str(command.arguments["language"])
        self._in_the_background(self._reporting(report["number"] + 1, language))
        return say("done.make_report")

    async def _reporting(self, number: int, language: str) -> None:
        try:
            self._report = await self._actions.report(language)
            self.screen.kept.report = {"state": "ready", "number": number}
        except OmmError as error:
            self.screen.kept.report = {"state": "failed", "number": number - 1}
            self.screen.trouble(say("trouble.refused_make_report"), of_error(error))
        self.screen.changes += 1
        self.show_soon()
