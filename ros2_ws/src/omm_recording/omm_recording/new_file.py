"""The file of a recording under way: who may write it, and how it comes to its name."""

import errno
import fcntl
import io
import os
import tempfile
from pathlib import Path
from typing import IO

from omm_core.errors import InputError

RESERVE_BYTES = 16 << 20


def created(final: Path, unfinished: Path) -> io.FileIO:
    """Make the file and lock it, so that one recording has one recorder."""
    if final.exists():
        raise InputError(
            f"{final} is a finished recording; recordings are never overwritten. "
            "Choose another folder."
        )
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        file = io.FileIO(unfinished, "x+")
    except FileExistsError as error:
        raise InputError(_why_there(unfinished)) from error
    except OSError as error:
        raise InputError(f"Cannot record to {final.parent}: {error.strerror}.") from error
    fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    return file


def _why_there(unfinished: Path) -> str:
    if being_written(unfinished):
        return f"Another recorder writes {unfinished}. Choose another folder, or stop it first."
    return (
        f"{unfinished} is a recording that was interrupted. Choose another folder, or bring it "
        f"into order first: ./omm repair {unfinished}"
    )


def being_written(path: Path) -> bool:
    """Return whether a recorder holds the lock of a file."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def reserved(folder: Path) -> IO[bytes]:
    """Take space for the index, so that a recording can be ended on a disk that is full.

    The file has no name: it vanishes by itself when the recorder is killed.
    """
    reserve = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - closed at the end
    try:
        os.posix_fallocate(reserve.fileno(), 0, RESERVE_BYTES)
    except OSError as error:
        reserve.close()
        raise InputError(
            f"Expected at least {RESERVE_BYTES >> 20} MB of free space in {folder}: "
            f"{error.strerror}."
        ) from error
    return reserve


def give_final_name(source: Path, final: Path) -> None:
    """Give a file its final name, unless something else has it by now."""
    try:
        os.link(source, final)
    except OSError as error:
        # File systems without hard links (exFAT on a stick); the lock makes the check safe.
        if error.errno == errno.EEXIST or final.exists():
            raise
        source.rename(final)
    else:
        source.unlink()
    sync_folder(final.parent)


def sync_folder(folder: Path) -> None:
    """Write the names in a folder to the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
