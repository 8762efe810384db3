"""Files that are there as a whole or not at all."""

import os
from pathlib import Path

from omm_core.errors import InputError


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file beside and give it its name when it is complete.

    Raises
    ------
    InputError
        If it cannot be written there.
    """
    data = content.encode() if isinstance(content, str) else content
    temporary = path.with_name(f"{path.name}.{os.getpid()}.new")
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise InputError(f"Cannot write {path}: {error.strerror}.") from error
