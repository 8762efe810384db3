"""What was measured and corrected in this session, in its order: before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from omm_operator.screen.facts import EstimateFact
from omm_operator.screen.result import Row

LARGEST = 50


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One clamping: its last result, and the jacks that were turned after it."""

    clamping: int
    at_ns: int
    rows: tuple[Row, ...]
    corrected: tuple[dict[str, Any], ...] = ()
    mode: str = ""


class History:
    """The results by clamping; the newest result of a clamping replaces its earlier ones."""

    def __init__(self) -> None:
        self._entries: list[Entry] = []

    def take(self, estimate: EstimateFact, rows: Sequence[Row]) -> None:
        """Take a result that holds."""
        before = self._entries[-1] if self._entries else None
        same = before is not None and before.clamping == estimate.clamping and not before.mode
        entry = Entry(clamping=estimate.clamping, at_ns=estimate.stamp_ns, rows=tuple(rows))
        self._entries = [*(self._entries[:-1] if same else self._entries), entry][-LARGEST:]

    def correct(self, mode: str, jacks: Sequence[dict[str, Any]]) -> bool:
        """Note that jacks were turned after the newest result; return False without a result."""
        if not self._entries:
            return False
        last = self._entries[-1]
        self._entries[-1] = Entry(
            clamping=last.clamping, at_ns=last.at_ns, rows=last.rows,
            corrected=tuple(jacks), mode=mode,
        )  # fmt: skip
        return True

    def to_json_list(self) -> list[dict[str, Any]]:
        """Return the entries as a page shows them, oldest first."""
        return [
            {
                "clamping": entry.clamping,
                "time_ms": entry.at_ns // 1_000_000,
                "rows": [row.to_json_dict() for row in entry.rows],
                "mode": entry.mode,
                "jacks": list(entry.corrected),
            }
            for entry in self._entries
        ]

    def corrections(self) -> int:
        """Return how often jacks were turned."""
        return sum(bool(entry.mode) for entry in self._entries)
