"""Ctrl-C as something to look at, not as an exception that strikes rclpy amid a message."""

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType

# Launch tools send SIGINT to a process and to its group, milliseconds apart: that is one wish. A
# person who presses Ctrl-C again after this time means that the callback that runs shall end.
ONE_WISH_S = 1.0


class Interrupts:
    """What SIGINT and SIGTERM do to a program: end it once, interrupt it at the second wish.

    While the program is closing nothing interrupts it any more: a recording that is being closed
    is closed, whatever comes.
    """

    def __init__(self) -> None:
        self.ended = threading.Event()
        self._first_s: float | None = None
        self._closing = False

    def close(self) -> None:
        """Ignore every SIGINT and SIGTERM from now on."""
        self._closing = True
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)

    def install(self) -> None:
        """Take both signals; in the main thread only."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take one signal.

        Raises
        ------
        KeyboardInterrupt
            At a SIGINT that comes later than ``ONE_WISH_S`` after the first, before `close`.
        """
        self.ended.set()
        now_s = time.monotonic()
        if self._first_s is None:
            self._first_s = now_s
        late = now_s - self._first_s > ONE_WISH_S
        if late and number == signal.SIGINT and not self._closing:
            raise KeyboardInterrupt


@contextlib.contextmanager
def told_to_end(*, for_good: bool = False) -> Iterator[threading.Event]:
    """Provide an event that the first Ctrl-C or SIGTERM sets; a second Ctrl-C interrupts.

    For the main thread of a program that spins by itself. It starts rclpy without rclpy's own
    signal handlers (`SignalHandlerOptions.NO`): these end ROS while it is being used.

    Parameters
    ----------
    for_good : whether the program ends afterwards: then no signal interrupts that any more
    """
    interrupts = Interrupts()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    interrupts.install()
    try:
        yield interrupts.ended
    finally:
        if for_good:
            interrupts.close()
        else:
            for number, handler in before.items():
                signal.signal(number, handler)
