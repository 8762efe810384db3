"""Message definitions of installed packages, as recordings carry them."""

import json
import re
from functools import cache
from pathlib import Path

from omm_core.errors import InputError

SEPARATOR = "=" * 80
_PRIMITIVES = frozenset(
    ["bool", "byte", "char", "float32", "float64", "string", "wstring"]
    + [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
)
# A field: its type (with an optional bound, `string<=10`), an optional array, and its name.
_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*")


@cache
def definition(type_name: str) -> str:
    """Return the definition of a type with all types it is made of, as ``ros2msg`` schemas have it.

    Parameters
    ----------
    type_name
        Such as ``sensor_msgs/msg/Image``.

    Raises
    ------
    InputError
        If the package is not installed, or has no such message.
    """
    texts: dict[str, str] = {}
    _collect(_short(type_name), texts)
    first, *others = texts.items()
    return first[1] + "".join(f"{SEPARATOR}\nMSG: {name}\n{text}" for name, text in others)


def fields_of(definition_text: str) -> list[str]:
    """Return what a definition is without comments and spacing: equal where the bytes are."""
    lines = (line.split("#")[0].split() for line in definition_text.splitlines())
    return [" ".join(words) for words in lines if words and "=" not in words[-1].strip("=")]


@cache
def type_hash(type_name: str) -> str:
    """Return the hash (RIHS01) of a type; empty where the package was installed without it."""
    path = _file(_short(type_name)).with_suffix(".json")
    if not path.is_file():
        return ""
    hashes = json.loads(path.read_text())["type_hashes"]
    found = [entry["hash_string"] for entry in hashes if entry["type_name"] == type_name]
    return str(found[0]) if found else ""


def _short(type_name: str) -> str:
    package, _, name = type_name.rpartition("/")
    return f"{package.removesuffix('/msg')}/{name}"


def _file(short_name: str) -> Path:
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    package, name = short_name.split("/")
    try:
        return Path(get_package_share_directory(package)) / "msg" / f"{name}.msg"
    except PackageNotFoundError as error:
        raise InputError(
            f"Expected the package {package} to be installed, for the definition of {short_name}. "
            "Source the workspace that it is in."
        ) from error


def _collect(short_name: str, texts: dict[str, str]) -> None:
    """Add the text of a type and then those of its fields."""
    if short_name in texts:
        return
    path = _file(short_name)
    try:
        text = path.read_text()
    except OSError as error:
        raise InputError(
            f"Expected the definition of {short_name} in {path}: {error.strerror}."
        ) from error
    texts[short_name] = text if text.endswith("\n") else text + "\n"
    package = short_name.split("/")[0]
    for line in text.splitlines():
        match = _FIELD.match(line.split("#")[0])
        if match and match[1] not in _PRIMITIVES:
            _collect(_short(match[1]) if "/" in match[1] else f"{package}/{match[1]}", texts)
