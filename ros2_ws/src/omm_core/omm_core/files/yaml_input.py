"""Read YAML files that people wrote: every mistake is told with file, key and what to do."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError


class YamlSection:
    """A mapping in a YAML file that knows where it stands, for messages.

    Parameters
    ----------
    values : mapping
        What the file says here.
    where : str
        File and keys down to here, as a person would look it up.
    """

    def __init__(self, values: Any, where: str) -> None:
        if not isinstance(values, dict):
            raise InputError(f"{where}: expected keys with values, got {_short(values)}.")
        self.values = values
        self.where = where

    def __contains__(self, key: str) -> bool:
        return self.values.get(key) is not None

    def get(self, key: str) -> Any:
        """Return the value of a key that must be there."""
        if key not in self:
            there = ", ".join(str(k) for k in self.values) or "none"
            raise InputError(f"{self.where}: the key '{key}' is missing (keys there: {there}).")
        return self.values[key]

    def section(self, key: str) -> YamlSection:
        """Return the mapping under a key."""
        return YamlSection(self.get(key), f"{self.where}: {key}")

    def text(self, key: str) -> str:
        """Return the words under a key."""
        value = self.get(key)
        if isinstance(value, (dict, list)):
            raise InputError(f"{self.where}: expected a name for '{key}', got {_short(value)}.")
        return str(value)

    def integer(self, key: str, *, minimum: int = 0) -> int:
        """Return the whole number under a key."""
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
            raise InputError(
                f"{self.where}: expected a whole number >= {minimum} for '{key}',"
                f" got {_short(value)}."
            )
        return value

    def number(self, key: str, *, above: float = -math.inf) -> float:
        """Return the finite number under a key."""
        return self._number(self.get(key), f"'{key}'", above)

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
        good = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not (good and math.isfinite(value) and value > above):
            wanted = "a finite number" if above == -math.inf else f"a number above {above:g}"
            raise InputError(f"{self.where}: expected {wanted} for {name}, got {_short(value)}.")
        return float(value)


def read_yaml(path: str | Path, what: str) -> YamlSection:
    """Return the contents of a YAML file.

    Parameters
    ----------
    path : path
        The file.
    what : str
        What it is, for messages ("part file").

    Raises
    ------
    InputError
        Where the file is missing, unreadable, not YAML, or not a mapping.
    """
    import yaml

    path = Path(path)
    try:
        loaded = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"Expected a {what} at {path}, but there is no such file.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"The {what} {path} cannot be read: {error}.") from None
    except yaml.YAMLError as error:
        raise InputError(f"The {what} {path} is not YAML: {' '.join(str(error).split())}") from None
    return YamlSection(loaded, str(path))


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
