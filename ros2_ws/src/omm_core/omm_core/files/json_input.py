"""JSON from outside: bounded; a key that stands twice, and NaN or infinity, are refused."""

from __future__ import annotations

import json
from typing import Any

from omm_core.errors import InputError
from omm_core.files.outside import Source, read_text


def read_json(path: Source, what: str) -> dict[str, Any]:
    """Return the object in a JSON file.

    Raises
    ------
    InputError
        Where the file is missing, unreadable, not JSON, or no object.
    """
    return parse_json(read_text(path, what), f"The {what} {path}")


def parse_json(text: str, where: str) -> dict[str, Any]:
    """Return the object that JSON text is; ``where`` is what it is, for messages."""
    try:
        value = json.loads(text, object_pairs_hook=_each_once, parse_constant=_no_number)
    except RecursionError:
        raise InputError(f"{where} is nested too deeply to be one.") from None
    except ValueError as error:  # a number of thousands of digits, too
        raise InputError(f"{where} is not JSON: {str(error)[:300]}.") from None
    if not isinstance(value, dict):
        raise InputError(f"{where}: expected an object, got {type(value).__name__}.")
    return value


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key '{twice[:80]}' stands twice; keep one of them")
    return values


def _no_number(name: str) -> Any:
    raise ValueError(f"expected finite numbers, got {name}")
