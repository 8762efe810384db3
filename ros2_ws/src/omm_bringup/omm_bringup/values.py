"""Values on the command line: finite numbers in their ranges, names that files can have.

Commands declare `type=float`, `type=int` and `type=Path`; what these take besides (nan, -1 images,
a name with NUL) is refused here for all of them, as a mistake of usage.
"""

import argparse
import math
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

_LARGEST = 2**31 - 1
_AT_LEAST = {
    "seed": 0, "jobs": 1, "clampings": 1, "repeats": 1, "count": 1, "port": 1, "timeout": 0.0,
    "rate": 0.0, "start": 0.0, "wait": 0.0, "scale": 0.0, "noise_px": 0.0, "min_contrast_dn": 0.0,
    "dot_mm": 0.0, "tolerance": 0.0, "remaining": 0.0, "bump": 0.0, "want_point": 0.0,
}  # fmt: skip
_AT_MOST = {"port": 65535, "jobs": 1024, "clampings": 100_000, "repeats": 100_000, "count": 10_000}

_NEGATIVE = re.compile(r"^-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?(,.*)?$")


def take_negative_numbers(parser: argparse.ArgumentParser) -> None:
    """Take -1e-3 and -1,2 for numbers: argparse knows no exponents and no lists.

    It has no public way to be told.
    """
    parser._negative_number_matcher = _NEGATIVE


def guard(parser: argparse.ArgumentParser) -> None:
    """Make the parser refuse values that nothing can be done with."""
    for action in _actions(parser):
        if action.type is float:
            action.type = _number(action.dest, float, "number")
        elif action.type is int:
            action.type = _number(action.dest, int, "whole number")
        elif action.type is Path:
            action.type = _path


def _actions(parser: argparse.ArgumentParser) -> Iterable[argparse.Action]:
    for action in parser._actions:  # argparse has no public way to them
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _actions(below)
        yield action


def _number(dest: str, kind: type, what: str) -> Callable[[str], Any]:
    low, high = _AT_LEAST.get(dest, -_LARGEST), _AT_MOST.get(dest, _LARGEST)

    def read(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            limits = f" from {low} to {high}" if dest in _AT_LEAST else ""
            raise argparse.ArgumentTypeError(f"expected a {what}{limits}, got {text[:80]!r}")
        return value

    return read


def _path(text: str) -> Path:
    if "\0" in text or not text:
        raise argparse.ArgumentTypeError(f"expected the name of a file, got {text[:80]!r}")
    return Path(text)
