"""Files that go into a recording: of the kind expected, of bounded size, as private as they were.

Their paths come from the parameters of a node, which others on the network may have set.
"""

import stat
from dataclasses import dataclass
from pathlib import Path

from omm_core.errors import InputError
from omm_core.files.outside import read_bytes
from omm_core.files.strict_yaml import parse_yaml

LARGEST_BYTES = 16 << 20
_KEYS = {"part.yaml": "part", "camera.yaml": "camera", "machine.yaml": "machine"}


@dataclass(frozen=True, kw_only=True)
class FileToRecord:
    """What a file holds, and who may read it (the permission bits)."""

    data: bytes
    mode: int


def file_to_record(path: Path, name: str) -> FileToRecord:
    """Read a file that is to be recorded as ``part.yaml``, ``camera.yaml`` or ``machine.yaml``.

    A machine may be a URDF, too: what reads it tells them apart by content.

    Raises
    ------
    InputError
        Where it cannot be read or is of another kind; its content is not told.
    """
    data = read_bytes(path, f"file to be recorded as {name}", LARGEST_BYTES)
    try:
        content = parse_yaml(data, str(path))
    except InputError:
        content = None
    of_its_kind = isinstance(content, dict) and _KEYS[name] in content
    if not (of_its_kind or (name == "machine.yaml" and _is_urdf(data))):
        raise InputError(
            f"{path} is not recorded: expected a {name} (YAML with the key '{_KEYS[name]}')."
        )
    return FileToRecord(data=data, mode=stat.S_IMODE(path.stat().st_mode))


def _is_urdf(data: bytes) -> bool:
    start = data[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
    return start.startswith(b"<") and b"<robot" in start
