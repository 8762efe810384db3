"""The errors of omm. Every message says what was expected, what came and what to do."""

import sys

from omm_core.printable import printable


class OmmError(Exception):
    """Base of all errors that omm raises on purpose."""


class InputError(OmmError):
    """What was given cannot be used: a file, a parameter, a name (exit status 2)."""


class MeasurementError(OmmError):
    """The input is sound, but the measurement failed or is not determined (exit status 1)."""


class DeviceError(OmmError):
    """A camera or a control is absent, lost or refuses."""


def warn(text: str) -> None:
    """Tell on stderr what was wrong with something that is used all the same."""
    print(f"omm: warning: {printable(text)}", file=sys.stderr)
