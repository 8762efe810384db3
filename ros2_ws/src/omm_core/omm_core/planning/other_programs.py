"""Measuring programs for other controls: templates, to be adapted by who knows the machine.

Positions are the axes' own, in machine coordinates. Where the handshake stands in each differs
from plant to plant (PLC variables, outputs): the lines between ``omm`` comments show the order in
which things must happen, with the control's usual means. No correction is read here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from omm_core.errors import InputError
from omm_core.planning.linuxcnc_program import linuxcnc_program
from omm_core.planning.program import Program


@dataclass(frozen=True, kw_only=True)
class _Dialect:
    """Lines of a control; {n} number, {x} axis words, {s} seconds, {t} title, {f} mm/min."""

    start: tuple[str, ...]
    move: str
    stop: tuple[str, ...]
    end: tuple[str, ...]
    comment: str
    sign: bool = False


_DIALECTS = {
    "siemens": _Dialect(
        start=("; {t}", "G71 G90 G94", "D0 ; no tool length", "R1={f}"),
        move="SUPA G1 {x} F=R1",
        stop=(
            "G4 F{s}",
            "; omm: number of the image, request, wait for the answer, withdraw",
            "R90={n}",
            "$A_OUT[1]=1",
            "WAIT_{n}:",
            "STOPRE",
            "IF $A_IN[1]==0 GOTOB WAIT_{n}",
            "$A_OUT[1]=0",
        ),
        end=("M30",),
        comment="; {c}",
    ),
    "heidenhain": _Dialect(
        start=("BEGIN PGM OMM MM", "; {t}"),
        move="L {x} FMAX M91",
        stop=(
            "CYCL DEF 9.0 DWELL TIME",
            "CYCL DEF 9.1 DWELL {s}",
            "; omm: number of the image, request, wait for the answer, withdraw",
            "Q90 = {n}",
            "FN 19: PLC = +1 / +{n}",
            "FN 20: WAIT FOR M4800==1",
            "FN 19: PLC = +0 / +0",
        ),
        end=("M30", "END PGM OMM MM"),
        comment="; {c}",
        sign=True,
    ),
    "fanuc": _Dialect(
        start=("%", "O9101 ({t})", "G21 G90 G94 G49"),
        move="G53 G0 {x}",
        stop=(
            "G4 X{s}",
            "(omm: number of the image, request, wait for the answer, withdraw)",
            "#1133={n}",
            "#1100=1",
            "WHILE[#1000EQ0]DO1",
            "END1",
            "#1100=0",
        ),
        end=("M30", "%"),
        comment="({c})",
    ),
    "fagor": _Dialect(
        start=("; {t}", "G71 G90 G94"),
        move="#MCS G1 {x} F{f}",
        stop=(
            "G4 K{s}",
            "; omm: number of the image, request, wait for the answer, withdraw",
            "V.PLC.R101={n}",
            "V.PLC.M1001=1",
            "#WAIT FOR [V.PLC.M1002 EQ 1]",
            "V.PLC.M1001=0",
        ),
        end=("M30",),
        comment="; {c}",
    ),
}
CONTROLS = ("linuxcnc", *_DIALECTS)


def program_text(program: Program, control: str = "linuxcnc") -> str:
    """Return the program in a control's words.

    Raises
    ------
    InputError
        Where there is no such control.
    """
    if control == "linuxcnc":
        return linuxcnc_program(program)
    dialect = _DIALECTS.get(control)
    if dialect is None:
        raise InputError(f"Expected a control out of {', '.join(CONTROLS)}, got {control!r}.")
    values = {"t": program.title, "f": f"{program.options.feed_mm_per_min:.0f}",
              "s": f"{program.options.dwell_s:g}"}  # fmt: skip
    lines = [line.format(**values) for line in dialect.start]
    note = "template: adapt the handshake to the machine, and try it without a part first"
    lines.insert(2, dialect.comment.format(c=note))
    first = program.stops[0].axes
    beside = {name: v for name, v in first.items() if name not in {*program.clear, *program.rotary}}
    turned = {name: v for name, v in first.items() if name in program.rotary}
    for axes in filter(None, (program.clear, turned, beside)):
        lines.append(_moved(program, dialect, axes))
    for number, stop in enumerate(program.stops, start=1):
        lines.append(dialect.comment.format(c=f"image {number}: {stop.label}"))
        for axes in (*stop.leave, *stop.arrive, stop.axes):
            lines.append(_moved(program, dialect, axes))
        lines += [line.format(n=number, **values) for line in dialect.stop]
    lines.append(_moved(program, dialect, program.away))
    return "\n".join([*lines, *dialect.end]) + "\n"


def _moved(program: Program, dialect: _Dialect, axes: Mapping[str, float]) -> str:
    words = []
    for name, value in axes.items():
        number = math.degrees(value) if name in program.rotary else value
        words.append(f"{name}{number:+.4f}" if dialect.sign else f"{name}{number:.4f}")
    return dialect.move.format(x=" ".join(words), f=f"{program.options.feed_mm_per_min:.0f}")
