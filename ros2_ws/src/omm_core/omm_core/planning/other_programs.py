"""Measuring programs for other controls: templates, to be adapted by who knows the machine.

Positions are the axes' own, in machine coordinates. Where the handshake stands in each differs
from plant to plant (PLC variables, outputs): the lines between ``omm`` comments show the order in
which things must happen, with the control's usual means. Those of Siemens, Fanuc and Heidenhain
take corrections of their next stop (led_dialects.py).

Before anything else the spindle goes out along the tool, from wherever it is, as in LinuxCNC's
program. What is changed of the modal state is put back as far as the control can tell it; where a
transformation or a tilted plane is active the program ends before it moves anything.
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
    """Lines of a control; {n} number, {x} axis words, {s} seconds, {t} title, {f} mm/min.

    In ``out`` {a} is the axis along the tool, {i} its number, {v} where all stops are cleared,
    {m} the move there; {nearer} compares with it, {beyond} (FN {fn}) for controls that jump over.
    ``told`` is what the operator has to know of the state that is found and left.
    """

    head: tuple[str, ...]
    told: tuple[str, ...]
    start: tuple[str, ...]
    out: tuple[str, ...]
    move: str
    stop: tuple[str, ...]
    withdraw: tuple[str, ...]
    end: tuple[str, ...]
    last: tuple[str, ...] = ()
    comment: str
    sign: bool = False


_DIALECTS = {
    # G710 is for lengths, feed and system variables; G71 leaves the feed to the machine's unit.
    "siemens": _Dialect(
        head=("; {t}",),
        told=(
            "put back at the end: D, G70 to G710, G90/G91, feed type; not: F, G1, R parameters",
            "before: no swivelled plane (CYCLE800())",
        ),
        start=(
            "IF $P_TRAFO<>0",
            'MSG("a transformation (TRAORI) is active: TRAFOOF first. Nothing was moved")',
            "M0",
            "M30",
            "ENDIF",
            "R61=$P_TOOL R62=$P_GG[13] R63=$P_GG[14] R64=$P_GG[15]",
            "G710 G90 G94",
            "D0 ; no tool length",
            "R1={f}",
        ),
        out=("STOPRE", "IF $AA_IM[{a}]{nearer}{v}", "{m}", "ENDIF"),
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
        end=("G[13]=R62", "G[14]=R63", "G[15]=R64", "D=R61", "M30"),
        comment="; {c}",
    ),
    "heidenhain": _Dialect(
        head=("BEGIN PGM OMM MM", "; {t}"),
        told=("changes no modal state but R0; M91 leaves preset and tool length alone",),
        start=(
            "FN 18: SYSREAD Q80 = ID210 NR6 ; tilted plane",
            "FN 10: IF +Q80 NE +0 GOTO LBL 992",
            "FN 18: SYSREAD Q80 = ID280 NR1 ; M128",
            "FN 10: IF +Q80 NE +0 GOTO LBL 992",
        ),
        out=(
            "FN 18: SYSREAD Q80 = ID240 NR1 IDX{i} ; {a} in machine coordinates",
            "FN {fn}: IF +Q80 {beyond} {v} GOTO LBL 991",
            "{m}",
            "LBL 991",
        ),
        move="L {x} R0 FMAX M91",
        stop=(
            "CYCL DEF 9.0 DWELL TIME",
            "CYCL DEF 9.1 DWELL {s}",
            "; omm: number of the image, request, wait for the answer, withdraw",
            "Q90 = {n}",
            "FN 19: PLC = +1 / +{n}",
            "FN 20: WAIT FOR M4800==1",
        ),
        withdraw=("FN 19: PLC = +0 / +0", "FN 20: WAIT FOR M4800==0"),
        end=(
            "M30",
            "LBL 992",
            "; tilted plane or M128 active: PLANE RESET STAY, M129 first. Nothing was moved",
            "STOP",
            "M30",
        ),
        last=("END PGM OMM MM",),
        comment="; {c}",
        sign=True,
    ),
    # No G49: alone in a block it may move the axis by the length offset. G53 does without it.
    "fanuc": _Dialect(
        head=("%", "O9101 ({t})"),
        told=(
            "put back at the end: G20/G21, G90/G91, G93 to G95; not: G0",
            "G43 is left alone, but G53 suspends its offset: G43 H again before the next cut",
        ),
        start=(
            "IF[[#4016GT68]AND[#4016LT69]]THEN#3000=1(G69 FIRST: TILTED PLANE)",
            "IF[[#4008GT43]AND[#4008LT44]]THEN#3000=2(G49 FIRST: G43.1 TO G43.5)",
            "#31=#4006",
            "#32=#4003",
            "#33=#4005",
            "G21 G90 G94",
        ),
        out=(
            "(#502{i}: {a} in machine coordinates, if it is axis {i} of this control)",
            "IF[#502{i}{beyond}{v}]GOTO900",
            "{m}",
            "N900",
        ),
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
        end=("G#31", "G#32", "G#33", "M30"),
        last=("%",),
        comment="({c})",
    ),
    "fagor": _Dialect(
        head=("; {t}",),
        told=(
            "G71, G90, G94, G1 and F are not put back: M30 sets the control's own",
            "before: no inclined plane (#CS OFF), no #RTCP",
        ),
        start=("G71 G90 G94",),
        out=("$IF V.A.TPOS.{a} {nearer} {v}", "{m}", "$ENDIF"),
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
_AXES = "XYZABCUVW"  # numbered so, from 1
_TEMPLATE = "template: adapt the handshake to the machine, and try it without a part first"
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
        lines = [line.format(t=program.title) for line in dialect.head]
        lines += [dialect.comment.format(c=line) for line in (_TEMPLATE, *self._told())]
        lines += [line.format(f=self._feed) for line in dialect.start]
        if led is not None:
            numbers = {"l": f"{options.limit_mm:.3f}", "k": options.tries}
            lines += [line.format(**numbers) for line in led.start]
        first = program.stops[0].axes
        skipped = {*program.clear, *program.rotary}
        beside = {name: v for name, v in first.items() if name not in skipped}
        turned = {name: v for name, v in first.items() if name in program.rotary}
        lines += self._out()
        for axes in filter(None, (turned, beside)):
            lines += self._moved(axes)
        for number, stop in enumerate(program.stops, start=1):
            lines += self._stop(number, stop)
        lines += self._moved(program.away)
        if program.touch is not None:
            words = words_of_touch(program.touch, self.control)
            lines += [dialect.comment.format(c=line) for line in words]
        return [*lines, *dialect.end, *(led.subprogram if led else ()), *dialect.last]

    def _told(self) -> tuple[str, ...]:
        """Return what the operator has to know of the state that is found and left."""
        ((axis, _),) = self.program.clear.items()
        head = f"before: the head as at the first stop, because the way out is along {axis} alone"
        return (*self.dialect.told, *((head,) if self.program.rotary else ()))

    def _out(self) -> list[str]:
        """Move along the tool only, from anywhere, to where all stops are cleared.

        Where the spindle is farther out already it stays: nothing is known of what lies between.
        """
        ((axis, clear),) = self.program.clear.items()
        (move,) = self._moved(self.program.clear)
        names = [*_AXES[:3], *(name for name in self.program.stops[0].axes if name not in "XYZ")]
        order = _AXES if self.control == "heidenhain" else names
        outward = self.program.outward > 0.0
        values = {
            "a": axis, "i": order.index(axis) + 1, "m": move,
            "v": f"{clear:{'+' if self.dialect.sign else ''}.4f}",
            "nearer": "<" if outward else ">", "beyond": "GT" if outward else "LT",
            "fn": 11 if outward else 12,
        }  # fmt: skip
        return [line.format(**values) for line in self.dialect.out]

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
