"""Read YAML files that people wrote: every mistake is told with file, key and what to do."""

from __future__ import annotations

import contextlib
import difflib
import math
import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError, did_you_mean, warn
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
    strict : bool
        Whether a key that nothing reads is refused; else it is warned of, for files may say more.
    """

    def __init__(
        self, values: Any, where: str, folder: Path = Path(), *, strict: bool = False
    ) -> None:
        if not isinstance(values, dict):
            raise InputError(f"{where}: expected keys with values, got {_short(values)}.")
        self.values = values
        self.where = where
        self.folder = folder
        self.strict = strict

    def __contains__(self, key: str) -> bool:
        return self.values.get(key) is not None

    def get(self, key: str) -> Any:
        """Return the value of a key that must be there."""
        if key not in self:
            there = ", ".join(str(k) for k in self.values) or "none"
            raise InputError(f"{self.where}: the key '{key}' is missing (keys there: {there}).")
        return self.values[key]

    def check_keys(self, *known: str) -> None:
        """Tell of keys that nothing reads, with the nearest known one: typing errors are quiet.

        Raises
        ------
        InputError
            Instead of a warning, where the section is strict.
        """
        for key in self.values:
            if str(key) in known:
                continue
            told = f"{self.where}: the key {_short(key)} is not known"
            if self.strict:
                advice = did_you_mean(str(key), known)
                raise InputError(f"{told}.{advice} Known here: {', '.join(known)}.")
            near = difflib.get_close_matches(str(key), known, 1, cutoff=0.0)
            warn(f"{told} and not read (nearest known one: {near[0]}).")

    def renamed(self, where: str) -> YamlSection:
        """Return the same section, called otherwise in messages."""
        return self._of(self.values, where)

    def _of(self, values: Any, where: str) -> YamlSection:
        return YamlSection(values, where, self.folder, strict=self.strict)

    def section(self, key: str) -> YamlSection:
        """Return the mapping under a key."""
        return self._of(self.get(key), f"{self.where}: {key}")

    def sections(self, key: str) -> tuple[YamlSection, ...]:
        """Return the list of mappings under a key; none where the key is absent."""
        given = self.get(key) if key in self else []
        if not isinstance(given, list):
            raise InputError(f"{self.where}: expected a list for '{key}', got {_short(given)}.")
        return tuple(
            self._of(entry, f"{self.where}: {key}, entry {number}")
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


def read_yaml(path: Source, what: str, *, strict: bool = False) -> YamlSection:
    """Return the contents of a YAML file.

    Parameters
    ----------
    path : path or Text
        The file, or its contents.
    what : str
        What it is, for messages ("part file").
    strict : bool
        Whether keys that nothing reads are refused.

    Raises
    ------
    InputError
        Where the file is missing, unreadable, not YAML, or not a mapping.
    """
    text = read_text(path, what)
    values = parse_yaml(text, f"The {what} {path}")
    return YamlSection(values, str(path), folder_of(path), strict=strict)


def _short(value: Any) -> str:
    # Bounded: what a few lines with aliases stand for may be endless when written out.
    return _BOUNDED.repr(value)
