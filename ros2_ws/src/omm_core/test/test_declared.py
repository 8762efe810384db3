"""Sections of files that dataclasses declare: what is written is read again, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

from omm_core.errors import InputError
from omm_core.files.declared import (
    choice,
    direction,
    each,
    file,
    number,
    numbers,
    part_of,
    read_section,
    text,
    truth,
    write_section,
)
from omm_core.files.outside import Text
from omm_core.files.yaml_input import YamlSection, read_yaml


@dataclass(frozen=True, kw_only=True)
class Inner:
    name: Annotated[str, text()]
    least_mm: Annotated[float | None, number(above=0.0), "minimum_mm"] = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Outer:
    kind: Annotated[str, choice("a", "b")]
    place_mm: Annotated[np.ndarray, numbers(3, digits=3)]
    normal: Annotated[np.ndarray | None, direction()] = None
    shown: Annotated[bool, truth()] = False
    inner: Annotated[Inner | None, part_of(Inner)] = None
    entries: Annotated[tuple[Inner, ...], each(Inner, once="name")] = ()
    beside: Annotated[Path | None, file()] = None
    index: int = 0


WHOLE = {
    "kind": "b",
    "place_mm": [1.0, 2.0, 3.0],
    "normal": [0.0, 0.0, 1.0],
    "shown": True,
    "inner": {"name": "i", "minimum_mm": 2.0},
    "entries": [{"name": "x"}, {"name": "y"}],
    "beside": "there.txt",
}


def section(**changes: object) -> YamlSection:
    return YamlSection({**WHOLE, **changes}, "some.yaml", Path("folder"), strict=True)


def test_what_is_read_is_written_again() -> None:
    outer = read_section(Outer, section(beside=None), index=7)
    written = write_section(outer)
    assert written == {key: value for key, value in WHOLE.items() if key != "beside"}
    assert outer.index == 7


def test_only_what_is_needed_must_be_there_and_defaults_are_not_written() -> None:
    least = {"kind": "a", "place_mm": [0, 0, 0]}
    outer = read_section(Outer, YamlSection(least, "some.yaml"))
    assert (outer.normal, outer.shown, outer.entries) == (None, False, ())
    assert write_section(outer) == least


def test_names_of_files_count_from_the_folder_of_the_file() -> None:
    assert read_section(Outer, section()).beside == Path("folder/there.txt")
    content = b"kind: a\nplace_mm: [0, 0, 0]\nbeside: x\n"
    root = read_yaml(Text(name="a text", content=content, folder=Path("/f")), "file")
    assert read_section(Outer, root).beside == Path("/f/x")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"shon": True}, "some.yaml: the key 'shon' is not known. Did you mean shown?"),
        ({"inner": {"name": "i", "least_mm": 1}}, "some.yaml: inner: the key 'least_mm' is not"),
        ({"inner": {"name": "i", "minimum_mm": 0}}, "expected a number above 0 for 'minimum_mm'"),
        ({"entries": [{"name": "x"}, {"name": "x"}]}, "entries: expected each name once, got x"),
        ({"entries": {"name": "x"}}, "expected a list for 'entries'"),
        ({"kind": "c"}, "expected kind to be one of a, b, got 'c'"),
        ({"kind": None}, "the key 'kind' is missing"),
        ({"normal": [0, 0, 0]}, "expected normal with a direction"),
        ({"shown": 1}, "expected true or false for 'shown'"),
    ],
)
def test_what_is_not_declared_is_refused_by_name(changes: dict[str, object], told: str) -> None:
    with pytest.raises(InputError) as caught:
        read_section(Outer, section(**changes))
    assert told in str(caught.value)
