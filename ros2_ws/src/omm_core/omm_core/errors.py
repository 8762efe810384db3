"""The errors of omm. Every message says what was expected, what came and what to do."""

import difflib
import sys
from collections.abc import Iterable

from omm_core.printable import printable


class OmmError(Exception):
    """Base of all errors that omm raises on purpose."""


class InputError(OmmError):
    """What was given cannot be used: a file, a parameter, a name (exit status 2)."""


class MeasurementError(OmmError):
    """The input is sound, but the measurement failed or is not determined (exit status 1)."""


class DeviceError(OmmError):
    """A camera or a control is absent, lost or refuses."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return " Did you mean …?" with the nearest known name; nothing where none is near."""
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f" Did you mean {near[0]}?" if near else ""


def warn(text: str) -> None:
    """Tell on stderr what was wrong with something that is used all the same."""
    print(f"omm: warning: {printable(text)}", file=sys.stderr)
