"""The commands that there are, and what they may carry: nothing else is ever taken from a page.

No argument becomes a path, a topic's name or a word for a control: they are numbers, one of a fixed
list, or a jack's name, which is only shown.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from omm_core.alignment.jacks import MODES
from omm_core.errors import InputError
from omm_operator.screen.correcting import typed_jacks
from omm_report.language import LANGUAGES

LARGEST_BODY = 4096
_KEY = re.compile(r"[A-Za-z0-9-]{8,64}")


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command; ``key`` is the same when a page sends it again."""

    name: str
    key: str
    arguments: Mapping[str, Any] = field(default_factory=dict)


def parse(body: bytes) -> Command:
    """Return the command in a request's body: ``{"command", "key", "arguments"}``.

    Raises
    ------
    InputError
        Where it is none of the commands, or carries anything that the command does not have.
    """
    if len(body) > LARGEST_BODY:
        raise InputError(f"Expected at most {LARGEST_BODY} bytes, got {len(body)}.")
    try:
        said = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise InputError("Expected a command as JSON.") from error
    if not isinstance(said, dict) or not set(said) <= {"command", "key", "arguments"}:
        raise InputError("Expected an object with command, key and arguments.")
    name, key, arguments = said.get("command"), said.get("key"), said.get("arguments", {})
    if not isinstance(name, str) or name not in _CHECKS:
        raise InputError(f"Expected a command out of {', '.join(_CHECKS)}.")
    if not isinstance(key, str) or not _KEY.fullmatch(key):
        raise InputError("Expected a key of 8 to 64 letters, digits or hyphens.")
    if not isinstance(arguments, dict):
        raise InputError("Expected the arguments as an object.")
    return Command(name=name, key=key, arguments=_CHECKS[name](arguments))


def _none(arguments: dict[str, Any]) -> dict[str, Any]:
    if arguments:
        raise InputError("Expected no arguments.")
    return {}


def _acknowledge(arguments: dict[str, Any]) -> dict[str, Any]:
    number = arguments.get("number")
    if set(arguments) != {"number"} or type(number) is not int or not 0 <= number < 2**31:
        raise InputError("Expected the number of an error, or 0 for all.")
    return {"number": number}


def _corrected(arguments: dict[str, Any]) -> dict[str, Any]:
    if set(arguments) != {"mode"} or arguments["mode"] not in MODES:
        raise InputError(f"Expected one of the modes {', '.join(MODES)}.")
    return {"mode": arguments["mode"]}


def _jacks(arguments: dict[str, Any]) -> dict[str, Any]:
    if set(arguments) != {"jacks"}:
        raise InputError("Expected jacks.")
    jacks = typed_jacks(arguments["jacks"])
    return {
        "jacks": [
            {"name": j.name, "x_mm": float(j.xyz_mm[0]), "y_mm": float(j.xyz_mm[1])} for j in jacks
        ]
    }


def _make_report(arguments: dict[str, Any]) -> dict[str, Any]:
    language = arguments.get("language", "en")
    if not set(arguments) <= {"language"} or language not in LANGUAGES:
        raise InputError(f"Expected one of the languages {', '.join(LANGUAGES)}.")
    return {"language": language}


_CHECKS = {
    "start_program": _none,
    "new_clamping": _none,
    "corrected": _corrected,
    "set_jacks": _jacks,
    "hand_over": _none,
    "read_offset": _none,
    "make_report": _make_report,
    "acknowledge": _acknowledge,
}
COMMANDS = tuple(_CHECKS)
# What an operator does; a viewer may do nothing at all.
ROLES = ("viewer", "operator")
