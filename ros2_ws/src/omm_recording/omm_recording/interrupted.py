"""Recordings that nobody closed: kept beside the one under way, told of, never in its way."""

import fcntl
import os
from datetime import datetime
from pathlib import Path

from omm_core.errors import InputError
from omm_recording.new_file import being_written
from omm_recording.run_files import UNFINISHED


def set_aside(final: Path) -> Path | None:
    """Rename what a killed recorder left where ``final`` is to be recorded.

    It gets the time of its last byte: ``run.mcap.unfinished`` becomes
    ``run-interrupted-20261126-063000.mcap.unfinished``. One that is still being written, or that
    was repaired already, stays as it is.

    Returns
    -------
    Path or None
        Its new name; None where there is nothing to set aside.

    Raises
    ------
    InputError
        If it cannot be renamed.
    """
    unfinished = final.with_name(final.name + UNFINISHED)
    if final.exists() or not unfinished.is_file():
        return None
    try:
        with unfinished.open("r+b") as file:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Who locked the file before us may have renamed it meanwhile.
            if not os.path.samestat(os.fstat(file.fileno()), unfinished.stat()):
                return None
            aside = _free_name(final, os.fstat(file.fileno()).st_mtime)
            unfinished.rename(aside)
    except (BlockingIOError, FileNotFoundError):  # another recorder's, which the writer tells
        return None
    except OSError as error:
        raise InputError(f"Cannot set {unfinished} aside: {error.strerror}.") from error
    return aside


def interrupted(folder: Path) -> list[Path]:
    """Return the recordings in a folder that were not closed, are not written, nor repaired."""
    return [
        path
        for path in sorted(folder.glob(f"*{UNFINISHED}"))
        if not path.with_name(path.name.removesuffix(UNFINISHED)).exists() and not _is_written(path)
    ]


def _is_written(path: Path) -> bool:
    try:
        return being_written(path)
    except OSError:  # it has just got its final name, or is not ours to read
        return True


def _free_name(final: Path, time_s: float) -> Path:
    stem = f"{final.stem}-interrupted-{datetime.fromtimestamp(time_s):%Y%m%d-%H%M%S}"
    names = (stem, *(f"{stem}-{k}" for k in range(2, 1000)))
    return next(
        path
        for name in names
        for path in [final.with_name(f"{name}{final.suffix}{UNFINISHED}")]
        if not path.exists() and not path.with_name(name + final.suffix).exists()
    )
