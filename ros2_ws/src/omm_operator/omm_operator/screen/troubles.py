"""What went wrong, with the time: it stays in the list until somebody has acknowledged it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from omm_report.language import Said

LARGEST = 200


@dataclass(frozen=True, kw_only=True)
class Trouble:
    """One thing that went wrong; ``count``: how often since it was first told."""

    number: int
    first_ns: int
    last_ns: int
    said: Said
    detail: Said | None = None
    count: int = 1


class Troubles:
    """The list, oldest first. What comes again while it stands there is counted."""

    def __init__(self, largest: int = LARGEST) -> None:
        self._largest = largest
        self._numbers = 0
        self._open: list[Trouble] = []
        self.dropped = 0
        """How many were pushed out by newer ones without having been acknowledged."""

    def add(self, said: Said, now_ns: int, detail: Said | None = None) -> None:
        """Take one more, with what a node said of it."""
        for at, trouble in enumerate(self._open):
            if (trouble.said, trouble.detail) == (said, detail):
                self._open[at] = replace(trouble, last_ns=now_ns, count=trouble.count + 1)
                return
        self._numbers += 1
        self._open.append(
            Trouble(number=self._numbers, first_ns=now_ns, last_ns=now_ns, said=said, detail=detail)
        )
        if len(self._open) > self._largest:
            self._open.pop(0)
            self.dropped += 1

    def acknowledge(self, number: int) -> bool:
        """Remove one, 0 for all that there are; returns whether there was such a one."""
        before = len(self._open)
        self._open = [t for t in self._open if number != 0 and t.number != number]
        if not self._open:
            self.dropped = 0
        return len(self._open) < before

    def all(self) -> Sequence[Trouble]:
        """Return those that nobody has acknowledged yet."""
        return tuple(self._open)
