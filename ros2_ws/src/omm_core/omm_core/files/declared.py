"""Sections of files as dataclasses that declare their keys: read and written by the declaration.

A field's type says how its key is read::

    @dataclass(frozen=True, kw_only=True)
    class Timing:
        settling_s: Annotated[float | None, number(least=0.0)] = None
        image_s: Annotated[float | None, number(least=0.0)] = None

    timing = read_section(Timing, root.section("timing"))

A field with a default may be absent; a key that no field declares is
warned of, for files may say more than omm reads. A text after the
reader is the key's name in the file where it is not the field's own.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

import numpy as np

from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection

_T = TypeVar("_T")


@dataclass(frozen=True)
class Reader:
    """How a key is read and written.

    Attributes
    ----------
    read : function
        From the section and the key to the field's value; raises InputError.
    write : function
        From the field's value to plain lists, mappings, numbers and texts.
    """

    read: Callable[[YamlSection, str], Any]
    write: Callable[[Any], Any] = lambda value: value


@dataclass(frozen=True)
class _Key:
    field: str
    name: str
    reader: Reader
    default: Any


_CACHE: dict[type[Any], tuple[_Key, ...]] = {}


def read_section(
    cls: type[_T], section: YamlSection, *, also: Collection[str] = (), **given: Any
) -> _T:
    """Return a dataclass filled from the section that it declares.

    Parameters
    ----------
    cls : dataclass
        Its annotated fields are read.
    section : YamlSection
        Where from.
    also : collection of str
        Further keys that the section may have: somebody else reads them.
    **given
        Values of fields that are not annotated, or not to be read.

    Raises
    ------
    InputError
        Where a key is missing, bad or not known.
    """
    keys = _keys_of(cls)
    section.check_keys(*(key.name for key in keys), *also)
    read = {
        key.field: key.reader.read(section, key.name)
        for key in keys
        if key.field not in given and (key.name in section or key.default is dataclasses.MISSING)
    }
    return cls(**read, **given)


def read_optional(cls: type[_T], root: YamlSection, key: str) -> _T | None:
    """Return the section under a key, as `read_section`; None where it is absent."""
    return read_section(cls, root.section(key)) if key in root else None


def read_each(cls: type[_T], root: YamlSection, key: str, *, once: str = "") -> tuple[_T, ...]:
    """Return the sections listed under a key; the field ``once`` may not have a value twice."""
    found = tuple(read_section(cls, entry) for entry in root.sections(key))
    if once:
        expect_once([getattr(one, once) for one in found], f"{root.where}: {key}", once)
    return found


def write_section(value: Any) -> dict[str, Any]:
    """Return the mapping from which `read_section` makes the same; defaults are left out."""
    return {
        key.name: key.reader.write(told)
        for key in _keys_of(type(value))
        if (told := getattr(value, key.field)) is not None and not _is_same(told, key.default)
    }


def expect_once(values: Collection[Any], where: str, what: str = "name") -> None:
    """Raise InputError where a value stands more than once."""
    twice = sorted(value for value, number in Counter(values).items() if number > 1)[:10]
    if twice:
        named = ", ".join(str(value) for value in twice)
        raise InputError(f"{where}: expected each {what} once, got {named} more than once.")


# --- readers --------------------------------------------------------------------------------------


def text() -> Reader:
    """Read a text."""
    return Reader(lambda section, key: section.text(key), str)


def choice(*known: str) -> Reader:
    """Read a text out of some."""

    def read(section: YamlSection, key: str) -> str:
        value = section.text(key)
        if value not in known:
            raise InputError(
                f"{section.where}: expected {key} to be one of {', '.join(known)}, got '{value}'."
            )
        return value

    return Reader(read, str)


def file() -> Reader:
    """Read the name of a file, which counts from the folder of the file that is read."""
    return Reader(lambda section, key: section.folder / section.text(key), str)


def truth() -> Reader:
    """Read true or false."""

    def read(section: YamlSection, key: str) -> bool:
        value = section.get(key)
        if not isinstance(value, bool):
            raise InputError(f"{section.where}: expected true or false for '{key}', got {value!r}.")
        return value

    return Reader(read)


def integer(minimum: int = 0) -> Reader:
    """Read a whole number."""
    return Reader(lambda section, key: section.integer(key, minimum=minimum), int)


def number(*, above: float = -math.inf, least: float = -math.inf) -> Reader:
    """Read a finite number above a limit, or not below one."""

    def read(section: YamlSection, key: str) -> float:
        value = section.number(key, above=above)
        if value < least:
            raise InputError(f"{section.where}: expected {key} >= {least:g}, got {value:g}.")
        return value

    return Reader(read, float)


def numbers(count: int, *, digits: int | None = None) -> Reader:
    """Read so many finite numbers, (count,); they are written with so many digits."""
    return Reader(lambda section, key: section.numbers(key, count), _rounded(digits))


def values(count: int) -> Reader:
    """Read so many finite numbers as a tuple."""
    return Reader(lambda section, key: tuple(map(float, section.numbers(key, count))), list)


def ordered(*, above: float = -math.inf) -> Reader:
    """Read two numbers as a tuple, the smaller one first."""

    def read(section: YamlSection, key: str) -> tuple[float, float]:
        low, high = (float(v) for v in section.numbers(key, 2))
        if not above < low < high:
            least = f" above {above:g}" if math.isfinite(above) else ""
            raise InputError(
                f"{section.where}: expected {key} as [smaller, larger]{least}, got"
                f" [{low:g}, {high:g}]."
            )
        return low, high

    return Reader(read, list)


def direction(*, digits: int = 9) -> Reader:
    """Read three numbers as a unit vector, (3,)."""

    def read(section: YamlSection, key: str) -> Any:
        given = section.numbers(key, 3)
        length = float(np.linalg.norm(given))
        if length < 1e-6:
            raise InputError(f"{section.where}: expected {key} with a direction, got {given}.")
        return given / length

    return Reader(read, _rounded(digits))


def per_axis(*, least: float = -math.inf, digits: int | None = None) -> Reader:
    """Read one number for all three axes, or one for each, (3,)."""

    def read(section: YamlSection, key: str) -> Any:
        if isinstance(section.get(key), list):
            given = section.numbers(key, 3)
        else:
            given = np.full(3, section.number(key))
        if np.any(given < least):
            raise InputError(f"{section.where}: expected {key} >= {least:g}, got {given}.")
        return given

    return Reader(read, _rounded(digits))


def part_of(cls: type[Any]) -> Reader:
    """Read a section as a dataclass that declares its keys."""
    return Reader(lambda section, key: read_section(cls, section.section(key)), write_section)


def each(cls: type[Any], *, once: str = "") -> Reader:
    """Read a list of sections as such dataclasses, a tuple; ``once`` as in `read_each`."""
    return Reader(
        lambda section, key: read_each(cls, section, key, once=once),
        lambda told: [write_section(one) for one in told],
    )


def _rounded(digits: int | None) -> Callable[[Any], list[float]]:
    def write(told: Any) -> list[float]:
        plain = [float(v) for v in told]
        return plain if digits is None else [round(v, digits) for v in plain]

    return write


def _keys_of(cls: type[Any]) -> tuple[_Key, ...]:
    if cls not in _CACHE:
        _CACHE[cls] = tuple(_declared(cls))
    return _CACHE[cls]


def _declared(cls: type[Any]) -> Iterator[_Key]:
    hints = typing.get_type_hints(cls, include_extras=True)
    for field in dataclasses.fields(cls):
        told = _annotations(hints[field.name])
        reader = next((one for one in told if isinstance(one, Reader)), None)
        if reader is not None:
            name = next((one for one in told if isinstance(one, str)), field.name)
            default = field.default
            if field.default_factory is not dataclasses.MISSING:
                default = field.default_factory()
            yield _Key(field.name, name, reader, default)


def _annotations(hint: Any) -> tuple[Any, ...]:
    """Return what stands in an ``Annotated``, also in one that is part of a union."""
    if typing.get_origin(hint) is Annotated:
        return tuple(hint.__metadata__)
    for part in typing.get_args(hint):
        if typing.get_origin(part) is Annotated:
            return tuple(part.__metadata__)
    return ()


def _is_same(value: Any, default: Any) -> bool:
    if isinstance(value, (np.ndarray, Mapping)):
        return type(value) is type(default) and bool(np.all(value == default))
    return bool(value == default)
