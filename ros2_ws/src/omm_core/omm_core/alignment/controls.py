"""The words of each control for a part's pose.

Each function takes the pose, the place where it must be right and the offset's name, and returns
`ControlLines`: the lines, and the pose that these lines, as rounded, say.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.alignment.control_lines import (
    ControlLines,
    fagor,
    fanuc,
    heidenhain,
    linuxcnc,
    siemens,
)
from omm_core.errors import InputError
from omm_core.geometry import RigidTransform

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Control:
    """A control: its words, its offsets, its comments."""

    offset: str
    """The offset where none is named."""
    offsets: str
    """The offsets there are, for messages."""
    number_of: Callable[[str], int | None]
    """Number of an offset in the control's own count, None where there is no such offset."""
    words: Callable[[RigidTransform, Array, str, int], ControlLines]
    comment: Callable[[str], str]


def _in_brackets(text: str) -> str:
    """Return a comment of Fanuc: capitals, no brackets inside, no small print."""
    return "(" + re.sub(r"[^A-Z0-9 .,:;#=+/<>-]", " ", text.upper()) + ")"


def _semicolon(text: str) -> str:
    return f"; {text}"


def _listed(names: tuple[str, ...]) -> Callable[[str], int | None]:
    return lambda name: names.index(name) + 1 if name in names else None


def _siemens_number(name: str) -> int | None:
    found = re.fullmatch(r"G(5[4-7]|5(?:0[5-9]|[1-9][0-9]))", name)
    if found is None:
        return None
    number = int(found[1])
    return number - 53 if number < 100 else number - 500


def _heidenhain_number(name: str) -> int | None:
    return int(name) if re.fullmatch(r"[0-9]{1,4}", name) else None


def _fanuc_number(name: str) -> int | None:
    found = re.fullmatch(r"G54\.1 ?P([1-9][0-9]{0,2})", name)
    if found is not None:
        return int(found[1]) if int(found[1]) <= 300 else None
    return _listed(_G54_TO_G59)(name)


_G54_TO_G59 = ("G54", "G55", "G56", "G57", "G58", "G59")
CONTROLS = {
    "linuxcnc": Control(
        offset="G54",
        offsets="G54 to G59, G59.1, G59.2, G59.3",
        number_of=_listed((*_G54_TO_G59, "G59.1", "G59.2", "G59.3")),
        words=linuxcnc,
        comment=_semicolon,
    ),
    "siemens": Control(
        offset="G54",
        offsets="G54 to G57, G505 to G599",
        number_of=_siemens_number,
        words=siemens,
        comment=_semicolon,
    ),
    "heidenhain": Control(
        offset="1",
        offsets="the number of a preset",
        number_of=_heidenhain_number,
        words=heidenhain,
        comment=_semicolon,
    ),
    "fanuc": Control(
        offset="G54",
        offsets="G54 to G59, G54.1 P1 to P300",
        number_of=_fanuc_number,
        words=fanuc,
        comment=_in_brackets,
    ),
    "fagor": Control(
        offset="G54",
        offsets="G54 to G59",
        number_of=_listed(_G54_TO_G59),
        words=fagor,
        comment=_semicolon,
    ),
}


def control_and_number(control: str, offset: str) -> tuple[Control, int]:
    """Return a control and the number of one of its offsets.

    Raises
    ------
    InputError
        Where there is no such control or offset.
    """
    known = CONTROLS.get(control)
    if known is None:
        raise InputError(f"Expected one of the controls {', '.join(CONTROLS)}, got '{control}'.")
    number = known.number_of(offset)
    if number is None:
        raise InputError(f"Expected an offset of {control}: {known.offsets}; got '{offset}'.")
    return known, number
