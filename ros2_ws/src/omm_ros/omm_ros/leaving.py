"""Threads that are left to end with the process: nobody waits for a compiler."""

import os
import sys
import threading

_left: list[threading.Thread] = []


def leave(thread: threading.Thread) -> None:
    """Let a thread that cannot be ended go on until the process ends."""
    _left.append(thread)


def end_process(status: int) -> int:
    """Return the status; end the process with it at once where a thread was left and still works.

    Python's own end waits for a thread that is inside of a compiler's library (LLVM), deaf to every
    signal; launch kills the node after ten seconds then. All else must be closed before.
    """
    if any(thread.is_alive() for thread in _left):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status
