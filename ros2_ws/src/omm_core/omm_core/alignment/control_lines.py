"""The words of each control for a part's pose.

Each function takes the pose, the place where it must be right and the offset's name, and returns
`ControlLines`: the lines, and the pose that these lines, as rounded, say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.alignment import angles
from omm_core.errors import MeasurementError
from omm_core.geometry import RigidTransform, rotation_from_euler_xyz_rad
from omm_core.words import Words, keyed, verbatim

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlLines:
    """What a control is told: lines before, that set, after; and the pose they say.

    ``unconfirmed`` is what has to be confirmed at this control before it is relied on.
    """

    lines: tuple[str, ...]
    said: RigidTransform
    unconfirmed: tuple[Words, ...]


def linuxcnc(pose: RigidTransform, place_mm: Array, name: str, number: int) -> ControlLines:
    """Return an offset with a turn about Z, right at ``place_mm`` (part frame); no tilt."""
    r = pose.rotation
    turn = round(math.degrees(math.atan2(r[1, 0] - r[0, 1], r[0, 0] + r[1, 1])), 9)
    turned = rotation_from_euler_xyz_rad(0.0, 0.0, math.radians(turn))
    xyz = np.round(pose @ place_mm - turned @ place_mm, 6)
    x, y, z = (_text(value, 6) for value in xyz)
    return ControlLines(
        lines=("G21 G90", f"G10 L2 P{number} X{x} Y{y} Z{z} R{_text(turn, 9)}", "M2"),
        said=RigidTransform(rotation=turned, translation_mm=xyz),
        unconfirmed=(
            keyed(
                "confirm.g92",
                "G92 is not set while {offset} is used (G92.1 clears it)",
                offset=verbatim(name),
            ),
        ),
    )


def siemens(pose: RigidTransform, place_mm: Array, name: str, number: int) -> ControlLines:
    """Return the settable frame, turned about Z, Y', X'' (RPY, MD10600 = 1)."""
    turn = tuple(round(angle, 8) for angle in angles.rpy_deg(pose.rotation))
    if abs(turn[1]) > 89.999:
        raise MeasurementError(
            keyed(
                "said.crot",
                "Expected a turn about Y of less than 90 degrees, got {angle}: CROT cannot express"
                " it unambiguously. Turn the part, or the frame it is described in.",
                angle=f"{turn[1]:.6f}",
            )
        )
    xyz = np.round(pose.translation_mm, 6)
    x, y, z = (_text(value, 6) for value in xyz)
    a, b, c = (_text(value, 8) for value in turn)
    return ControlLines(
        lines=(
            "IF $MN_FRAME_ANGLE_INPUT_MODE <> 1",
            '  MSG("omm: MD10600 is not 1 (RPY), frame not written")',
            "  SETAL(65000)",
            "  M0",
            "ELSE",
            f"  $P_UIFR[{number}] = CTRANS(X,{x},Y,{y},Z,{z}) : CROT(X,{a},Y,{b},Z,{c})",
            "ENDIF",
            "M30",
        ),
        said=RigidTransform(rotation=angles.rotation_of_rpy(_three(turn)), translation_mm=xyz),
        unconfirmed=(
            keyed(
                "confirm.metric",
                "the control's basic system is metric; the frame is used where the program says"
                " {offset}",
                offset=verbatim(name),
            ),
            keyed("confirm.alarm", "alarm 65000 is free on this control"),
        ),
    )


def heidenhain(pose: RigidTransform, place_mm: Array, name: str, number: int) -> ControlLines:
    """Return a row of the preset table.

    SPA, SPB and SPC turn about the fixed A, B and C; the control keeps four decimals.
    """
    turn = tuple(round(angle, 4) for angle in angles.rpy_deg(pose.rotation))
    xyz = np.round(pose.translation_mm, 4)
    columns = zip(("X", "Y", "Z", "SPA", "SPB", "SPC"), (*xyz, *turn), strict=True)
    row = " ".join(f"{column} {_text(value, 4, sign=True)}" for column, value in columns)
    return ControlLines(
        lines=(f"NR {number} {row}",),
        said=RigidTransform(rotation=angles.rotation_of_rpy(_three(turn)), translation_mm=xyz),
        unconfirmed=(
            keyed(
                "confirm.preset",
                "the preset table has the columns SPA, SPB, SPC and reads them as PLANE SPATIAL"
                " does (about fixed A, then B, then C)",
            ),
            keyed("confirm.decimals", "four decimals are kept in each column"),
        ),
    )


def fanuc(pose: RigidTransform, place_mm: Array, name: str, number: int) -> ControlLines:
    """Return the offset of the place, then G68.2 with angles about Z, X', Z''."""
    xyz = [_eight_digits(value) for value in pose.translation_mm]
    turn = [_eight_digits(value) for value in angles.zxz_deg(pose.rotation)]
    error = [_eight_digits(value) for value in angles.xyz_turned_deg(pose.rotation)]
    table = f"L20 P{number}" if name.startswith("G54.1") else f"L2 P{number}"
    numbers = [float(value) for value in (*xyz, *turn)]
    g54_4 = " ".join(
        f"#{26010 + at}={value}"
        for at, value in zip((0, 1, 2, 3, 4, 5), (*xyz, *error), strict=True)
    )
    return ControlLines(
        lines=(
            "G21 G90",
            f"G10 {table} X{xyz[0]} Y{xyz[1]} Z{xyz[2]}",
            name,
            f"G68.2 X0. Y0. Z0. I{turn[0]} J{turn[1]} K{turn[2]}",
            "M30",
        ),
        said=RigidTransform(
            rotation=angles.rotation_of_zxz(_three(numbers[3:])),
            translation_mm=np.array(numbers[:3]),
        ),
        unconfirmed=(
            keyed(
                "confirm.increment",
                "the control keeps 5 decimals (increment system IS-D or IS-E); IS-B keeps 3",
            ),
            keyed(
                "confirm.g53_1",
                "G53.1 turns the tool to this plane and moves axes: it is not in here, call it"
                " where that is safe. G69 ends G68.2",
            ),
            keyed(
                "confirm.g54_4",
                "instead of G68.2, G54.4 P1 with a zero offset would be {numbers}, order about X,"
                " Y, Z of the current system; +2, +3, +4 are inferred",
                numbers=verbatim(g54_4),
            ),
        ),
    )


def fagor(pose: RigidTransform, place_mm: Array, name: str, number: int) -> ControlLines:
    """Return the 8070's offset, then a coordinate system of MODE 1 (about X, Y', Z'')."""
    xyz = np.round(pose.translation_mm, 5)
    turn = tuple(round(angle, 6) for angle in angles.xyz_turned_deg(pose.rotation))
    x, y, z = (_text(value, 5) for value in xyz)
    a, b, c = (_text(value, 6) for value in turn)
    return ControlLines(
        lines=(
            "G71 G90",
            *(
                f"V.A.ORGT[{number}].{axis} = {value}"
                for axis, value in zip("XYZ", (x, y, z), strict=True)
            ),
            name,
            f"#CS DEF [1] [MODE 1, 0, 0, 0, {a}, {b}, {c}]",
            "M30",
        ),
        said=RigidTransform(
            rotation=angles.rotation_of_xyz_turned(_three(turn)), translation_mm=xyz
        ),
        unconfirmed=(
            keyed("confirm.mode_1", "MODE 1 turns about X, then the turned Y, then the turned Z"),
            keyed(
                "confirm.orgt",
                "{variable} is {offset}; #CS ON [1] switches the system on",
                variable=verbatim(f"V.A.ORGT[{number}]"),
                offset=verbatim(name),
            ),
            keyed(
                "confirm.g49",
                "on an 8055 instead: {block} with a zero offset",
                block=verbatim(f"G49 X{x} Y{y} Z{z} A{a} B{b} C{c}"),
            ),
        ),
    )


def _text(value: float, decimals: int, *, sign: bool = False) -> str:
    """Return a number without exponent and without a negative zero."""
    rounded = round(float(value), decimals) + 0.0
    return f"{rounded:{'+' if sign else ''}.{decimals}f}"


def _eight_digits(value: float) -> str:
    """Return a number of 5 decimals, fewer where it would have more than Fanuc's 8 digits."""
    whole = len(f"{abs(value):.0f}")
    return _text(value, max(0, min(5, 8 - whole)))


def _three(values: tuple[float, ...] | list[float]) -> tuple[float, float, float]:
    a, b, c = values
    return a, b, c
