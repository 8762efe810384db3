"""A measuring program for LinuxCNC, with the handshake that the bridge answers.

Before anything else the spindle goes out along the tool, from wherever it is. What the program
changes of the modal state is restored at its end (M70, M72). The tool length is left alone: G53
does without it, and M72 would not give a G43.1 back.

For each stop: go there, wait, ask for image n (``M68 E0 Qn`` and ``M64 P0``), wait for the answer
(``M66 P0 L3``), read the correction of the next stop, withdraw the request, wait until the answer
is withdrawn too. An image that does not come stops the program with a message instead of leaving a
hole in the measurement.

The correction: where ``motion.digital-in-01`` is set, ``motion.analog-in-00`` to ``-02`` shift the
next stop along X, Y, Z (mm), clamped to ``#<_omm_limit_mm>`` here, by the program itself. With
``-03`` = 2 nothing was seen: the same stop is tried again where the shift leads, ``#<_omm_tries>``
times at most. Where a look for the part shows nothing, or no correction is valid, the program ends.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from omm_core.errors import InputError
from omm_core.planning.program import Program, ProgramStop
from omm_core.planning.touch import linuxcnc_touch

_WORDS = "XYZABCUVW"
_SHIFTED = "XYZ"


def linuxcnc_program(program: Program) -> str:
    """Return the text, in machine coordinates (G53), mm and degrees.

    Raises
    ------
    InputError
        Where an axis has a name that is not a word of G-code.
    """
    names = list(program.stops[0].axes)
    bad = [name for name in names if len(name) != 1 or name not in _WORDS]
    if bad:
        raise InputError(f"Expected axes of LinuxCNC, any of {', '.join(_WORDS)}, got {bad[0]}.")
    options = program.options
    corrected = options.limit_mm > 0.0
    lines = [
        f"({program.title}: {len(program.stops)} images)",
        "M70 (M72 restores the modal state)",
        "G21 G90 G94 G40 G17",
        "G64 P0.001",
        *(_corrections_start(program) if corrected else []),
        *_out(program),
    ]
    first = program.stops[0]
    if turned := {name: first.axes[name] for name in names if name in program.rotary}:
        lines.append(f"G53 G0 {_words(program, turned)}")
    lines += ["M65 P0", "M66 P0 L4 Q5 (no old answer)", f"F{options.feed_mm_per_min:.0f}"]
    lines.append(f"G53 G0 {_words(program, _beside(program, first))}")
    clear = {**first.axes, **program.clear}
    inward = {name: value for name, value in clear.items() if name not in program.rotary}
    lines.append(f"G53 G1 {_words(program, inward)}")
    for number, stop in enumerate(program.stops, start=1):
        lines += _stop(program, number, stop, corrected)
    lines += _away(program)
    if program.touch is not None:
        lines += linuxcnc_touch(program.touch, program.away[program.touch.axis])
    lines += ["M72", "M2", "%"]
    return "%\n" + "\n".join(lines) + "\n"


def _corrections_start(program: Program) -> list[str]:
    return [
        f"#<_omm_limit_mm> = {program.options.limit_mm:.3f} (largest correction, each axis)",
        f"#<_omm_tries> = {program.options.tries} (images of one stop where nothing is seen)",
        *(f"#<_omm_{letter.lower()}> = 0" for letter in _SHIFTED),
    ]


def _out(program: Program) -> list[str]:
    """Move along the tool only, from anywhere, to where all stops are cleared.

    Where the spindle is farther out already it stays: nothing is known of what lies between.
    """
    ((name, clear),) = program.clear.items()
    nearer = "LT" if program.outward > 0.0 else "GT"
    return [
        "(first out along the tool, then beside the first stop, then in)",
        f"O99 IF [#<_abs_{name.lower()}> {nearer} {clear:.4f}]",
        f"G53 G0 {name}{clear:.4f}",
        "O99 ENDIF",
    ]


def _away(program: Program) -> list[str]:
    ((name, away),) = program.away.items()
    return [f"G53 G1 {name}{away:.4f}"]


def _beside(program: Program, stop: ProgramStop) -> dict[str, float]:
    """Return the linear axes across the tool, as far out as the spindle is."""
    skipped = {*program.clear, *program.rotary}
    return {name: value for name, value in stop.axes.items() if name not in skipped}


def _words(program: Program, axes: Mapping[str, float], shift: str = "") -> str:
    """Return axis words; shifted by the parameters ``#<_omm_x>`` (shift "_omm_") or others."""
    words = []
    for name, value in axes.items():
        number = f"{math.degrees(value) if name in program.rotary else value:.4f}"
        if shift and name in _SHIFTED:
            number = f"[{number} + #<{shift}{name.lower()}>]"
        words.append(f"{name}{number}")
    return " ".join(words)


def _stop(program: Program, number: int, stop: ProgramStop, corrected: bool) -> list[str]:
    shift, before = ("_omm_", "omm_old_") if corrected else ("", "")
    lines = [f"(image {number}: {stop.label})"]
    lines += [f"G53 G1 {_words(program, axes, before)}" for axes in stop.leave]
    lines += [f"G53 G1 {_words(program, axes, shift)}" for axes in stop.arrive]
    if corrected and stop.look:  # it stands back by the limit: as much more may be needed inwards
        lines.append(f"#<_omm_limit_mm> = {2.0 * program.options.limit_mm:.3f}")
    if corrected:
        lines += ["#<omm_try> = 0", f"O{1000 + number} DO"]
    lines += [
        f"G53 G1 {_words(program, stop.axes, shift)}",
        f"G4 P{program.options.dwell_s:g}",
        f"M68 E0 Q{number}",
        "M64 P0",
        f"M66 P0 L3 Q{program.options.answer_timeout_s:g}",
        f"O{2000 + number} IF [#5399 LT 0]",
        "M65 P0",
        f"(MSG,no image {number}: see /cnc/state for the reason)",
        "M72",
        "M2",
        f"O{2000 + number} ENDIF",
    ]
    if corrected:
        lines += _read_correction(number)
    lines += ["M65 P0", "M66 P0 L4 Q5"]
    if corrected:
        again = "[#<omm_seen> EQ 2] AND [#<omm_try> LT #<_omm_tries>]"
        lines += ["#<omm_try> = [#<omm_try> + 1]", f"O{1000 + number} WHILE [{again}]"]
    if corrected and stop.look:
        lines += _end_unless_seen(number)
        lines.append(f"#<_omm_limit_mm> = {program.options.limit_mm:.3f}")
        lines += [line for i in range(3) for line in _clamped(50000 + i, i)]
    return lines


def _end_unless_seen(number: int) -> list[str]:
    """End the program where the part was not found: nothing is then known to be clear."""
    return [
        f"O{4000 + number} IF [[#<omm_valid> EQ 0] OR [#<omm_seen> EQ 2]]",
        "(MSG,the part was not found: does the bridge have the plan_file? is the part there?)",
        "M72",
        "M2",
        f"O{4000 + number} ENDIF",
    ]


def _read_correction(number: int) -> list[str]:
    """Take the next stop's shift from the inputs, where one is valid, and clamp it."""
    lines = [f"#<omm_old_{letter.lower()}> = #<_omm_{letter.lower()}>" for letter in _SHIFTED]
    lines += ["#<omm_seen> = 0", "M66 P1 L0", "#<omm_valid> = #5399"]
    lines.append(f"O{3000 + number} IF [#<omm_valid> EQ 1]")
    for i, letter in enumerate(_SHIFTED):
        lines += [f"M66 E{i} L0", f"#<_omm_{letter.lower()}> = #5399"]
        lines += _clamped(10000 + 10 * number + i, i)
    return [*lines, "M66 E3 L0", "#<omm_seen> = #5399", f"O{3000 + number} ENDIF"]


def _clamped(block: int, index: int) -> list[str]:
    name = f"#<_omm_{_SHIFTED[index].lower()}>"
    return [
        f"O{block} IF [{name} GT #<_omm_limit_mm>]",
        f"{name} = #<_omm_limit_mm>",
        f"O{block} ELSEIF [{name} LT [0 - #<_omm_limit_mm>]]",
        f"{name} = [0 - #<_omm_limit_mm>]",
        f"O{block} ENDIF",
    ]
