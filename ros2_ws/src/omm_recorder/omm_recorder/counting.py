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

    def as_text(self, recorded: int) -> str:
        """For the recording's report."""
        return json.dumps(
            {
                "received": self.received,
                "recorded": recorded,
                "lost_by_recorder": self.received - recorded,
                "missing_from_publisher": self.missing,
                "published_before_first": self.before_first,
                "longest_pause_s": round(self.longest_pause_ns / 1e9, 6),
                "longest_pause_at_ns": self.longest_pause_at_ns,
            }
        )
