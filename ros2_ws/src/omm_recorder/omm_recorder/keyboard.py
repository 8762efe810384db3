"""Single keys from the terminal, where there is one."""

import os
import select
import sys
import termios
import time
import tty
from types import TracebackType
from typing import Any

SPACE = " "
RIGHT = "\x1b[C"
UP = "\x1b[A"
DOWN = "\x1b[B"


class Keyboard:
    """Reads keys without Enter while in a ``with`` statement; without a terminal it only waits."""

    def __init__(self) -> None:
        self._descriptor: int | None = None
        self._before: list[Any] = []

    @property
    def present(self) -> bool:
        """Whether somebody can press keys."""
        return self._descriptor is not None

    def __enter__(self) -> "Keyboard":
        try:
            descriptor = sys.stdin.fileno()
        except (AttributeError, ValueError, OSError):  # no standard input at all
            return self
        # A job in the background must not touch the terminal: it would be stopped.
        if os.isatty(descriptor) and os.tcgetpgrp(descriptor) == os.getpgrp():
            self._before = termios.tcgetattr(descriptor)
            tty.setcbreak(descriptor)
            self._descriptor = descriptor
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._descriptor is not None:
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)
            self._descriptor = None

    def key(self, timeout_s: float) -> str | None:
        """Wait for a key; None where none came in time."""
        if self._descriptor is None:
            time.sleep(timeout_s)
            return None
        if not select.select([self._descriptor], [], [], timeout_s)[0]:
            return None
        # An arrow comes as three bytes at once.
        return os.read(self._descriptor, 3).decode(errors="replace")
