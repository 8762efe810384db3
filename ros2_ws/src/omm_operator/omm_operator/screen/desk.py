"""Where commands arrive: each is checked, recorded, carried out once, and answered.

A command that comes again, with the key that it had or within a second of its twin (a double tap,
two pages), gets the answer of the first; nothing is done twice.
"""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from omm_operator.screen.commands import Command
from omm_report.language import Said, say

TWIN_S = 1.0
_REMEMBERED = 500


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What became of a command."""

    accepted: bool
    said: Said
    more: Mapping[str, Any] = field(default_factory=dict)
    """What was done, for the record: the corrections that were on the screen, and the like."""

    def to_json_dict(self) -> dict[str, Any]:
        """Return what a page gets."""
        return {"accepted": self.accepted, "said": self.said.to_json_dict()}


@dataclass(frozen=True, kw_only=True)
class Asker:
    """Who gives a command."""

    who: str
    role: str


class Record(Protocol):
    """Takes down what was asked (no answer yet) and what was answered."""

    def __call__(self, asker: Asker, command: Command, answer: Answer | None) -> None:
        """Take down."""


Refusal = Callable[[Command], Said | None]
Carry = Callable[[Command], Awaitable[Answer]]


class Desk:
    """Takes commands.

    Parameters
    ----------
    refusal : callable
        Why a command cannot be carried out now; None where it can.
    carry : callable
        Carries a command out.
    record : callable
        Takes down commands and answers.
    clock : callable
        Seconds, monotonic.
    """

    def __init__(
        self,
        refusal: Refusal,
        carry: Carry,
        record: Record,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._refusal, self._carry, self._record, self._clock = refusal, carry, record, clock
        self._by_key: OrderedDict[tuple[str, str], asyncio.Future[Answer]] = OrderedDict()
        self._twins: dict[str, tuple[float, asyncio.Future[Answer]]] = {}

    async def take(self, asker: Asker, command: Command) -> Answer:
        """Return the answer to a command, carrying it out unless that is being done already."""
        if asker.role != "operator":
            answer = Answer(accepted=False, said=say("command.only_viewer"))
            self._record(asker, command, answer)
            return answer
        known = self._by_key.get((asker.who, command.key)) or self._twin(command)
        if known is None:
            known = asyncio.ensure_future(self._do(asker, command))
            self._remember(asker, command, known)
        return await asyncio.shield(known)

    def _twin(self, command: Command) -> asyncio.Future[Answer] | None:
        at_s, answer = self._twins.get(_identity(command), (0.0, None))
        under_way = answer is not None and not answer.done()
        recent = answer is not None and self._clock() - at_s <= TWIN_S
        return answer if under_way or recent else None

    def _remember(self, asker: Asker, command: Command, answer: asyncio.Future[Answer]) -> None:
        self._by_key[(asker.who, command.key)] = answer
        while len(self._by_key) > _REMEMBERED:
            self._by_key.popitem(last=False)
        now_s = self._clock()
        self._twins = {
            name: (at_s, twin)
            for name, (at_s, twin) in self._twins.items()
            if not twin.done() or now_s - at_s <= TWIN_S
        }
        self._twins[_identity(command)] = (now_s, answer)

    async def _do(self, asker: Asker, command: Command) -> Answer:
        why = self._refusal(command)
        if why is not None:
            answer = Answer(accepted=False, said=why)
        else:
            self._record(asker, command, None)
            answer = await self._carry(command)
        self._record(asker, command, answer)
        return answer


def _identity(command: Command) -> str:
    return f"{command.name} {sorted(command.arguments.items())!r}"
