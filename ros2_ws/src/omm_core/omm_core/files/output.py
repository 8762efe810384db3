"""Files that are there as a whole or not at all."""

import fcntl
import os
from pathlib import Path

from omm_core.errors import InputError


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file beside and give it its name when it is complete.

    A link stays a link: the file that it leads to is written. What is no ordinary file (a device,
    a FIFO) is written to, not replaced.

    Raises
    ------
    InputError
        If it cannot be written there.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        special = path.exists() and not path.is_file() and not path.is_dir()
        path = path if special else path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"Cannot write {path}: {error}.") from error
    if special:
        _write_special(path, data)
        return
    temporary = path.with_name(f"{path.name}.{os.getpid()}.new")
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise InputError(f"Cannot write {path}: {error.strerror}.") from error


def _write_special(path: Path, data: bytes) -> None:
    try:
        # Without a reader a FIFO would wait for ever.
        descriptor = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
        os.set_blocking(descriptor, True)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
    except OSError as error:
        raise InputError(f"Cannot write {path}: {error.strerror}.") from error


def take_folder(folder: Path) -> None:
    """Make a folder one's own before anything is written to it, until the process ends.

    Raises
    ------
    InputError
        If another process has it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise InputError(f"Cannot make the folder {folder}: {error.strerror}.") from error
    try:
        # The lock ends with the process, however it ends: nothing is left to clean up.
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise InputError(
            f"Another process writes into {folder}. Name another folder, or wait."
        ) from error
    _TAKEN.append(descriptor)


_TAKEN: list[int] = []
"""Open folders whose locks this process holds."""
