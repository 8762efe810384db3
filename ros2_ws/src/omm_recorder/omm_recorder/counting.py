"""What became of the messages: received, recorded, lost here, or missing on the way."""

import json
from dataclasses import dataclass, field


@dataclass
class TopicTally:
    """The count of one topic's messages.

    `missing` comes from the numbers that the publisher gives its messages; it is None where
    several publishers share the topic, because their numbers cannot be told apart.
    """

    received: int = 0
    lost: int = 0
    missing: int | None = 0
    before_first: int = 0
    """Numbers that the publisher had given before the first message came: it was there earlier,
    or the connection took a while."""
    longest_pause_ns: int = 0
    longest_pause_at_ns: int = 0
    missing_at_end: int | None = None
    """After the last one that came, as its publisher told at the end; None where it did not."""
    announced: int | None = None
    """How many the publisher said it had published, the last time that it said so."""
    _before: int = field(default=0, repr=False)
    _announced_s: float = field(default=-1.0, repr=False)
    _last: int | None = field(default=None, repr=False)
    _last_ns: int | None = field(default=None, repr=False)

    def see(self, sequence: int, time_ns: int) -> int:
        """Count a message with the publisher's number; returns how many are missing before it."""
        self.received += 1
        if self._last_ns is not None and time_ns - self._last_ns > self.longest_pause_ns:
            self.longest_pause_ns = time_ns - self._last_ns
            self.longest_pause_at_ns = self._last_ns
        self._last_ns = time_ns
        last, self._last = self._last, sequence
        if last is None:
            self.before_first = sequence - 1
        if last is None or self.missing is None or sequence == last + 1:
            return 0
        if sequence == 1:  # the publisher was started again
            return 0
        if sequence <= last:
            self.missing = None
            return 0
        gap = sequence - last - 1
        self.missing += gap
        return gap

    def announce(self, published: int, now_s: float) -> None:
        """Take what the publisher says: how many messages it has published."""
        if self.announced is not None and published < self.announced:
            # It was started again; a number of its former life says nothing of this one.
            self._last = self._last if (self._last or 0) <= published else 0
        elif self.announced is None and self._last is None:
            self._before = published
        self.announced, self._announced_s = published, now_s

    def answered(self, since_s: float) -> bool:
        """Return whether the publisher has since said its number, and all up to it has come."""
        told = self._announced_s >= since_s and self.announced is not None
        return told and (self.announced or 0) <= self._have()

    def _have(self) -> int:
        """Return the number up to which all is here, or was published before the first came."""
        return self._before if self._last is None else self._last

    def end(self, since_s: float) -> None:
        """Count what is missing at the end, where the publisher told its number since then."""
        if self.missing is None or self.announced is None or self._announced_s < since_s:
            return
        self.missing_at_end = max(0, self.announced - self._have())
        self.missing += self.missing_at_end

    def as_text(self, recorded: int) -> str:
        """Return the counts as text for the recording's report."""
        return json.dumps(
            {
                "received": self.received,
                "recorded": recorded,
                "lost_by_recorder": self.received - recorded,
                "missing_from_publisher": self.missing,
                "missing_at_end": self.missing_at_end,
                "published_before_first": self.before_first,
                "longest_pause_s": round(self.longest_pause_ns / 1e9, 6),
                "longest_pause_at_ns": self.longest_pause_at_ns,
            }
        )
