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
    _last: int | None = field(default=None, repr=False)

    def see(self, sequence: int) -> int:
        """Count a message with the publisher's number; returns how many are missing before it."""
        self.received += 1
        last, self._last = self._last, sequence
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
            }
        )
