"""Read YAML files that people wrote: every mistake is told with file, key and what to do."""

from __future__ import annotations

import contextlib
import math
import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError, did_you_mean
from omm_core.files.outside import Source, folder_of, read_text
from omm_core.files.strict_yaml import parse_yaml

_BOUNDED = reprlib.Repr()
_BOUNDED.maxlevel, _BOUNDED.maxstring, _BOUNDED.maxother = 2, 80, 80
_BOUNDED.maxlist = _BOUNDED.maxdict = 6


class YamlSection:
    """A mapping in a YAML file that knows where it stands, for messages.

    Parameters
    ----------
    values : mapping
        What the file says here.
    where : str
        File and keys down to here, as a person would look it up.
    folder : Path
        From where the names of files count.
    """

    def __init__(self, values: Any, where: str, folder: Path = Path()) -> None:
        if not isinstance(values, dict):
            raise InputError(f"{where}: expected keys with values, got {_short(values)}.")
        self.values = values
        self.where = where
        self.folder = folder

    def __contains__(self, key: str) -> bool:
        return self.values.get(key) is not None

    def get(self, key: str) -> Any:
        """Return the value of a key that must be there."""
        if key not in self:
            there = ", ".join(str(k) for k in self.values) or "none"
            raise InputError(f"{self.where}: the key '{key}' is missing (keys there: {there}).")
        return self.values[key]

    def refuse_unknown(self, *known: str) -> None:
        """Raise InputError where a key is not known: a misspelt one would count as not told."""
        for key in self.values:
            if str(key) not in known:
                raise InputError(
                    f"{self.where}: the key {_short(key)} is not known."
                    f"{did_you_mean(str(key), known)} Known here: {', '.join(known)}."
                )

    def renamed(self, where: str) -> YamlSection:
        """Return the same section, called otherwise in messages."""
        return YamlSection(self.values, where, self.folder)

    def section(self, key: str) -> YamlSection:
        """Return the mapping under a key."""
        return YamlSection(self.get(key), f"{self.where}: {key}", self.folder)

    def sections(self, key: str) -> tuple[YamlSection, ...]:
        """Return the list of mappings under a key; none where the key is absent."""
        given = self.get(key) if key in self else []
        if not isinstance(given, list):
            raise InputError(f"{self.where}: expected a list for '{key}', got {_short(given)}.")
        return tuple(
            YamlSection(entry, f"{self.where}: {key}, entry {number}", self.folder)
            for number, entry in enumerate(given, start=1)
        )

    def text(self, key: str) -> str:
        """Return the words under a key."""
        value = self.get(key)
        if isinstance(value, (dict, list, bool)):
            raise InputError(
                f"{self.where}: expected a name for '{key}', got {_short(value)}. Put it in quotes"
                " if it is one."
            )
        return str(value)

    def integer(self, key: str, *, minimum: int = 0, maximum: int = 2**31 - 1) -> int:
        """Return the whole number under a key."""
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not minimum <= value <= maximum:
            raise InputError(
                f"{self.where}: expected a whole number >= {minimum} (at most {maximum}) for"
                f" '{key}', got {_short(value)}."
            )
        return value

    def number(self, key: str, *, above: float = -math.inf, least: float = -math.inf) -> float:
        """Return the finite number under a key, above the one limit and not below the other."""
        value = self._number(self.get(key), f"'{key}'", above)
        if value < least:
            raise InputError(
                f"{self.where}: expected {least:g} or more for '{key}', got {value:g}."
            )
        return value

    def numbers(self, key: str, count: int | None = None) -> NDArray[np.float64]:
        """Return the list of finite numbers under a key; of any length where count is None."""
        value = self.get(key)
        if not isinstance(value, Sequence) or isinstance(value, str):
            raise InputError(
                f"{self.where}: expected a list of numbers for '{key}', got {_short(value)}."
            )
        if count is not None and len(value) != count:
            raise InputError(
                f"{self.where}: expected {count} numbers for '{key}', got {len(value)}:"
                f" {_short(value)}."
            )
        return np.array([self._number(item, f"each of '{key}'", -math.inf) for item in value])

    def _number(self, value: Any, name: str, above: float) -> float:
        # YAML 1.1 reads 1e-3 (without a dot) as text; people mean the number.
        if isinstance(value, str):
            with contextlib.suppress(ValueError):
                value = float(value)
        if isinstance(value, int) and abs(value) > 1 << 1000:  # math would not take it
            value = math.inf
        good = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not (good and math.isfinite(value) and value > above):
            wanted = "a finite number" if above == -math.inf else f"a number above {above:g}"
            raise InputError(f"{self.where}: expected {wanted} for {name}, got {_short(value)}.")
        return float(value)


def read_yaml(path: Source, what: str) -> YamlSection:
    """Return the contents of a YAML file.

    Parameters
    ----------
    path : path or Text
        The file, or its contents.
    what : str
        What it is, for messages ("part file").

    Raises
    ------
    InputError
        Where the file is missing, unreadable, not YAML, or not a mapping.
    """
    text = read_text(path, what)
    return YamlSection(parse_yaml(text, f"The {what} {path}"), str(path), folder_of(path))


def _short(value: Any) -> str:
    # Bounded: what a few lines with aliases stand for may be endless when written out.
    return _BOUNDED.repr(value)
