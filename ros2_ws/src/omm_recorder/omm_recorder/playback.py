"""When each message of a recording is due: rate, pause, single steps."""

import time
from collections.abc import Callable

MIN_RATE = 0.01
MAX_RATE = 1000.0


class PlaybackClock:
    """The recording's time as it goes on while it is played.

    Parameters
    ----------
    start_ns
        The recording's time at the beginning.
    rate
        How many times faster than it was recorded.
    paused
        Whether it stands still at first.
    now_s
        The wall's time; another one for tests.
    """

    def __init__(
        self,
        start_ns: int,
        *,
        rate: float = 1.0,
        paused: bool = False,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._now_s = now_s
        self._anchor_ns = start_ns
        self._anchor_s = now_s()
        self._rate = rate
        self._paused = paused
        self._steps = 0

    @property
    def rate(self) -> float:
        """How many times faster than it was recorded."""
        return self._rate

    @property
    def paused(self) -> bool:
        """Whether the time stands still."""
        return self._paused

    def now_ns(self) -> int:
        """Return the recording's time now."""
        if self._paused:
            return self._anchor_ns
        return self._anchor_ns + int((self._now_s() - self._anchor_s) * self._rate * 1e9)

    def wait_s(self, message_ns: int) -> float | None:
        """Return how long until a message is due; None while time stands still before it."""
        if self._steps:
            return 0.0
        if self._paused:
            return None if message_ns > self._anchor_ns else 0.0
        return max(0.0, (message_ns - self.now_ns()) / 1e9 / self._rate)

    def played(self, message_ns: int) -> None:
        """Note that a message went out: a step is used up, and time stands where the message is."""
        if self._steps:
            self._steps -= 1
            self._set(max(self._anchor_ns, message_ns))

    def toggle_pause(self) -> None:
        """Pause or continue."""
        self._set(self.now_ns())
        self._paused = not self._paused

    def step(self) -> None:
        """Play one message while paused."""
        if self._paused:
            self._steps += 1

    def change_rate(self, factor: float) -> None:
        """Play faster or slower from here on."""
        self._set(self.now_ns())
        self._rate = min(max(self._rate * factor, MIN_RATE), MAX_RATE)

    def _set(self, time_ns: int) -> None:
        self._anchor_ns = time_ns
        self._anchor_s = self._now_s()
