"""Read YAML files that people wrote: every mistake is told with file, key and what to do."""

from __future__ import annotations

import contextlib
import math
import reprlib
import stat
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError

_LARGEST_BYTES = 20 << 20
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
        loaded = yaml.load(_text(path, what), Loader=_strict_loader())
    except yaml.YAMLError as error:
        raise InputError(f"The {what} {path} is not YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise InputError(f"The {what} {path} is nested too deeply to be one.") from None
    except ValueError as error:  # a number of thousands of digits
        raise InputError(f"The {what} {path} cannot be read: {error}.") from None
    return YamlSection(loaded, str(path))


def _text(path: Path, what: str) -> str:
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"Expected a {what} at {path}, but that is no ordinary file.")
        if status.st_size > _LARGEST_BYTES:
            raise InputError(
                f"Expected a {what} of at most {_LARGEST_BYTES >> 20} MB at {path},"
                f" got {status.st_size / 1e6:.0f} MB."
            )
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"Expected a {what} at {path}, but there is no such file.") from None
    except (OSError, ValueError) as error:
        raise InputError(f"The {what} {path} cannot be read: {error}.") from None


@cache
def _strict_loader() -> Any:
    """Return a safe loader that refuses a key that stands twice: YAML's own lets the last win."""
    import yaml

    class Strict(yaml.SafeLoader):
        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            lines: dict[str, int] = {}
            for key, _ in node.value:
                name, line = str(key.value), key.start_mark.line + 1
                if name in lines and isinstance(key.value, str) and name != "<<":
                    raise yaml.constructor.ConstructorError(
                        None,
                        None,
                        f"the key '{name}' stands twice, in lines {lines[name]} and {line};"
                        " keep one of them",
                        key.start_mark,
                    )
                lines[name] = line
            return dict(super().construct_mapping(node, deep))

    return Strict


def _short(value: Any) -> str:
    # Bounded: what a few lines with aliases stand for may be endless when written out.
    return _BOUNDED.repr(value)
