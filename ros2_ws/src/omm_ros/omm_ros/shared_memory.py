"""Shared memory that dead processes left behind.

Fast DDS removes the segment of a process that ends, not of one that is killed. Ours hold 64 MB
each; a machine PC that runs for months would fill up with them until images find no room.
"""

import contextlib
import fcntl
import os
import re
import time
from pathlib import Path

_FOLDER = Path("/dev/shm")
_SEGMENT = re.compile("fastrtps_[0-9a-f]{16}")
# A segment and its lock are not made in one step: what is new is left alone.
_NEW_S = 30.0


def remove_leftovers(folder: Path = _FOLDER) -> int:
    """Remove this user's Fast DDS segments of which the owner lives no more; returns how many.

    As `fastdds shm clean` does: a living owner holds a lock on the file `<segment>_el`.
    """
    if not folder.is_dir():
        return 0
    return sum(_remove_if_left(p) for p in folder.iterdir() if _SEGMENT.fullmatch(p.name))


def _remove_if_left(segment: Path) -> bool:
    lock_file = segment.with_name(f"{segment.name}_el")
    # Whoever starts beside us may remove the same file.
    with contextlib.suppress(FileNotFoundError):
        status = segment.stat()
        if status.st_uid != os.geteuid() or time.time() - status.st_mtime < _NEW_S:
            return False
        with open(lock_file, "rb") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return False
            segment.unlink()
            lock_file.unlink()
            return True
    return False
