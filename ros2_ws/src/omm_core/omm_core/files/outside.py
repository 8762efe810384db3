"""Bytes and text of files that others wrote: ordinary files only, of bounded size."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path

from omm_core.errors import InputError

LARGEST_BYTES = 64 << 20


@dataclass(frozen=True, kw_only=True)
class Text:
    """The contents of a file that lies in no folder (in a recording, in a message).

    Attributes
    ----------
    name : str
        What messages call it.
    content : bytes
        What the file would hold.
    folder : Path
        Where files lie that it names.
    """

    name: str
    content: bytes
    folder: Path = Path()

    def __str__(self) -> str:
        return self.name


Source = str | Path | Text
"""A file by its path, or its contents: every loader takes either."""


def folder_of(source: Source) -> Path:
    """Return the folder from which the names in a file count."""
    return source.folder if isinstance(source, Text) else Path(source).parent


def file_in(source: Source, name: str) -> Source:
    """Return the file of that name where a folder is given; else what is given."""
    if isinstance(source, Text) or not Path(source).is_dir():
        return source
    return Path(source) / name


def read_bytes(path: Source, what: str, largest: int = LARGEST_BYTES) -> bytes:
    """Return what a file holds.

    Parameters
    ----------
    path : path or Text
        The file, or its contents.
    what : str
        What it is, for messages ("part file").
    largest : int
        How many bytes one of its kind may have.

    Raises
    ------
    InputError
        Where it is missing, unreadable, too large, or no ordinary file (a device, a FIFO).
    """
    data = path.content if isinstance(path, Text) else _read(path, what, largest)
    if len(data) > largest:
        raise InputError(
            f"Expected a {what} of at most {largest / 1e6:.0f} MB at {path}, got a larger one."
        )
    return data


def _read(path: str | Path, what: str, largest: int) -> bytes:
    try:
        # A FIFO without a writer would wait for ever at a plain open.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise InputError(f"Expected a {what} at {path}, but that is not an ordinary file.")
            # Files of /proc say 0 and go on; so what is read counts, not what is said.
            return file.read(largest + 1)
    except FileNotFoundError:
        raise InputError(f"Expected a {what} at {path}, but there is no such file.") from None
    except IsADirectoryError:
        raise InputError(f"Expected a {what} at {path}, but that is a folder.") from None
    except (OSError, ValueError) as error:
        told = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"The {what} {path} cannot be read: {told}.") from None


def read_text(path: Source, what: str, largest: int = LARGEST_BYTES) -> str:
    """Return the text (UTF-8, with or without a byte order mark) of a file, as `read_bytes`."""
    try:
        return read_bytes(path, what, largest).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"The {what} {path} cannot be read as UTF-8: {error}.") from None
