"""Measuring programs for other controls: templates, to be adapted by who knows the machine.

Positions are the axes' own, in machine coordinates. Where the handshake stands in each differs
from plant to plant (PLC variables, outputs): the lines between ``omm`` comments show the order in
which things must happen, with the control's usual means. Those of Siemens, Fanuc and Heidenhain
take corrections of their next stop (led_dialects.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from omm_core.errors import InputError
from omm_core.planning.led_dialects import FIRST, LED, Led
from omm_core.planning.linuxcnc_program import linuxcnc_program
from omm_core.planning.program import Program, ProgramStop
from omm_core.planning.touch import words_of_touch


@dataclass(frozen=True, kw_only=True)
class _Dialect:
    """Lines of a control; {n} number, {x} axis words, {s} seconds, {t} title, {f} mm/min."""

    start: tuple[str, ...]
    move: str
    stop: tuple[str, ...]
    withdraw: tuple[str, ...]
    end: tuple[str, ...]
    last: tuple[str, ...] = ()
    comment: str
    sign: bool = False


_DIALECTS = {
    "siemens": _Dialect(
        start=("; {t}", "G71 G90 G94", "D0 ; no tool length", "R1={f}"),
        move="SUPA G1 {x} F=R1",
        stop=(
            "G4 F{s}",
            "; omm: number of the image, request, wait for the answer, withdraw",
            "STOPRE",
            "R11=0 R10={n}",
            "WAIT_{n}:",
            "STOPRE",
            "IF R11<>{n} GOTOB WAIT_{n}",
        ),
        withdraw=("R10=0",),
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
        ),
        withdraw=("FN 19: PLC = +0 / +0", "FN 20: WAIT FOR M4800==0"),
        end=("M30",),
        last=("END PGM OMM MM",),
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
        ),
        withdraw=("#1100=0", "WHILE[#1000EQ1]DO1", "END1"),
        end=("M30",),
        last=("%",),
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
        ),
        withdraw=("V.PLC.M1001=0", "#WAIT FOR [V.PLC.M1002 EQ 0]"),
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
        Where there is no such control, or the program looks for the part: LinuxCNC's does that.
    """
    if control == "linuxcnc":
        return linuxcnc_program(program)
    dialect = _DIALECTS.get(control)
    if dialect is None:
        raise InputError(f"Expected one of the controls {', '.join(CONTROLS)}, got {control!r}.")
    if any(stop.look for stop in program.stops):
        raise InputError(f"A search for the part (--search) is for LinuxCNC only, got {control}.")
    led = LED.get(control) if program.options.limit_mm > 0.0 else None
    return "\n".join(_Writer(program, control, dialect, led).lines()) + "\n"


@dataclass(frozen=True)
class _Writer:
    """A program in a dialect, with or without corrections."""

    program: Program
    control: str
    dialect: _Dialect
    led: Led | None

    def lines(self) -> list[str]:
        """Return all lines."""
        program, dialect, led = self.program, self.dialect, self.led
        options = program.options
        lines = [line.format(t=program.title, f=self._feed) for line in dialect.start]
        note = "template: adapt the handshake to the machine, and try it without a part first"
        lines.insert(2, dialect.comment.format(c=note))
        if led is not None:
            numbers = {"l": f"{options.limit_mm:.3f}", "k": options.tries}
            lines += [line.format(**numbers) for line in led.start]
        first = program.stops[0].axes
        skipped = {*program.clear, *program.rotary}
        beside = {name: v for name, v in first.items() if name not in skipped}
        turned = {name: v for name, v in first.items() if name in program.rotary}
        for axes in filter(None, (program.clear, turned, beside)):
            lines += self._moved(axes)
        for number, stop in enumerate(program.stops, start=1):
            lines += self._stop(number, stop)
        lines += self._moved(program.away)
        if program.touch is not None:
            words = words_of_touch(program.touch, self.control)
            lines += [dialect.comment.format(c=line) for line in words]
        return [*lines, *dialect.end, *(led.subprogram if led else ()), *dialect.last]

    @property
    def _feed(self) -> str:
        return f"{self.program.options.feed_mm_per_min:.0f}"

    def _stop(self, number: int, stop: ProgramStop) -> list[str]:
        led, dialect = self.led, self.dialect
        old, now = (led.old, led.now) if led else ("", "")
        values = {"n": number, "back": 1000 + number, "skip": 2000 + number,
                  "s": f"{self.program.options.dwell_s:g}"}  # fmt: skip
        lines = [dialect.comment.format(c=f"image {number}: {stop.label}")]
        for axes in stop.leave:
            lines += self._moved(axes, old)
        for axes in stop.arrive:
            lines += self._moved(axes, now)
        lines += [line.format(**values) for line in (led.again if led else ())]
        lines += self._moved(stop.axes, now)
        read, loop = (led.read, led.loop) if led else ((), ())
        handshake = (*dialect.stop, *read, *dialect.withdraw, *loop)
        return lines + [line.format(**values) for line in handshake]

    def _moved(self, axes: Mapping[str, float], shift: str = "") -> list[str]:
        words, before = [], []
        for name, value in axes.items():
            number = math.degrees(value) if name in self.program.rotary else value
            if not (shift and self.led and name in "XYZ"):
                sign = "+" if self.dialect.sign else ""
                words.append(f"{name}{number:{sign}.4f}")
                continue
            parts = {
                "a": name, "v": f"{number:.4f}", "p": shift, "u": f"{abs(number):.4f}",
                "s": " - " if number < 0.0 else " + ",
                "j": FIRST[self.control] + "XYZ".index(name),
            }  # fmt: skip
            words.append(self.led.word.format(**parts))
            if self.led.before:
                before.append(self.led.before.format(**parts))
        return [*before, self.dialect.move.format(x=" ".join(words), f=self._feed)]
