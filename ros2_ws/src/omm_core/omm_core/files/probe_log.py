"""What a control wrote down while it probed: one touch a line.

Two forms are read, told apart line by line:

- LinuxCNC's ``(PROBEOPEN file)``: nine numbers, X Y Z and the six other axes;
- words X, Y, Z with a number behind each, as programs of other controls write them (Fanuc's DPRNT,
  Siemens' WRITE, Heidenhain's FN 16), with a name before them or none. Lines without such words are
  headings.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.outside import read_text
from omm_core.files.probed import ProbedPoint

Array = NDArray[np.float64]

_NINE = 9
_NUMBER = r"[-+]?[ \t]*(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
# DPRNT fills up with blanks and puts the next letter right behind a number.
_WORD = re.compile(rf"(?<![A-Za-z_])([XYZ])[ \t]*[:=]?[ \t]*({_NUMBER})(,\d)?", re.IGNORECASE)
_INCH = re.compile(r"\b(INCH|INCHES|G20|G70)\b", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True, eq=False)
class LoggedTouch:
    """One touch of a log: its name, empty where none is told, and X Y Z, mm."""

    name: str
    place_mm: Array
    line: int


def with_log(
    points: Sequence[ProbedPoint], path: Path, offset_mm: Sequence[float] = (0.0, 0.0, 0.0)
) -> tuple[ProbedPoint, ...]:
    """Return points with what a control's log says, by name where it names all, else in its order.

    Parameters
    ----------
    offset_mm : three numbers
        What is added to each position of the log, machine axes: from the spindle to the tip where
        the log tells the spindle, or a work offset that was active.

    Raises
    ------
    InputError
        Where the log holds no touch, another number than there are points, or a name that none has.
    """
    touches = read_probe_log(path)
    named = all(touch.name for touch in touches) and bool(
        {touch.name for touch in touches} & {point.name for point in points}
    )
    ordered = _by_name(points, touches, path) if named else touches
    if len(ordered) != len(points):
        raise InputError(
            f"{path}: expected a line for each of the {len(points)} points, got {len(ordered)}."
        )
    offset = np.asarray(offset_mm, dtype=float)
    return tuple(
        replace(point, machine_mm=touch.place_mm + offset)
        for point, touch in zip(points, ordered, strict=True)
    )


def read_probe_log(path: Path) -> tuple[LoggedTouch, ...]:
    """Return all touches of a log.

    Raises
    ------
    InputError
        Where there is none, a line holds X, Y, Z not once each, or it is in inches.
    """
    touches = []
    for number, line in enumerate(read_text(path, "probe log").splitlines(), start=1):
        touch = _touch(line, f"{path}, line {number}", number)
        if touch is not None:
            touches.append(touch)
    if not touches:
        raise InputError(
            f"{path}: expected touches, found none: lines with X, Y and Z and a number behind each"
            " (DPRNT, WRITE, FN 16), or LinuxCNC's nine numbers a line (PROBEOPEN)."
        )
    return tuple(touches)


def _touch(line: str, where: str, number: int) -> LoggedTouch | None:
    if _INCH.search(line):
        raise InputError(f"{where}: expected mm, got a log in inches: {line.strip()!r}.")
    bare = line.split()
    if bare and all(re.fullmatch(_NUMBER, word) for word in bare):
        if len(bare) != _NINE:
            raise InputError(
                f"{where}: expected {_NINE} numbers (X Y Z A B C U V W), got {len(bare)}."
            )
        return LoggedTouch(name="", place_mm=_place(bare[:3], where), line=number)
    words = list(_WORD.finditer(line))
    if not words:
        return None
    if any(word[3] for word in words):
        raise InputError(f"{where}: expected decimal points, got a comma: {line.strip()!r}.")
    by_axis = {word[1].upper(): word[2] for word in words}
    if sorted(word[1].upper() for word in words) != ["X", "Y", "Z"]:
        raise InputError(
            f"{where}: expected X, Y and Z once each, got {line.strip()!r}: have the program write"
            " one line a touch (docs/budget.md)."
        )
    name = line[: words[0].start()].strip(" \t:;,|()")
    return LoggedTouch(
        name=name, place_mm=_place([by_axis[axis] for axis in "XYZ"], where), line=number
    )


def _place(words: Sequence[str], where: str) -> Array:
    place = np.array([float("".join(word.split())) for word in words])
    if not np.isfinite(place).all():
        raise InputError(f"{where}: expected finite positions, got {' '.join(words)}.")
    return place


def _by_name(
    points: Sequence[ProbedPoint], touches: Sequence[LoggedTouch], path: Path
) -> tuple[LoggedTouch, ...]:
    """Return touches in the order of the points: the first of a name for its first point, ..."""
    known = {point.name for point in points}
    strange = [touch for touch in touches if touch.name not in known]
    if strange:
        raise InputError(
            f"{path}, line {strange[0].line}: expected one of the points' names, got"
            f" {strange[0].name!r}."
        )
    left = {name: [touch for touch in touches if touch.name == name] for name in known}
    ordered = []
    for point in points:
        if not left[point.name]:
            raise InputError(f"{path}: expected a touch of {point.name!r}, got none (left).")
        ordered.append(left[point.name].pop(0))
    spare = [touch for rest in left.values() for touch in rest]
    if spare:
        raise InputError(
            f"{path}, line {spare[0].line}: {spare[0].name!r} is touched more often than the points"
            " say."
        )
    return tuple(ordered)
