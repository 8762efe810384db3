"""How programs of other controls take corrections of their next stop: parameters and lines.

What a bridge or the PLC sets before an image is answered: whether a correction is valid, the shift
told along X, Y, Z (mm), and a status (0 as planned, 1 corrected, 2 nothing seen). The program takes
it over where it is valid, each shift clamped to its own limit, and leaves a stop by the shift with
which it came. With status 2 it tries the same stop again where the shift leads, so many times.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Led:
    """Lines of a control.

    In ``start`` {l} is the limit and {k} the tries; {n} is the image in ``again``, ``read`` and
    ``loop``. In ``word`` {a} is an axis' name, {v} its value, {s} its sign as an operator with a
    blank on each side, {u} its value without, {j} 1 to 3 for X, Y, Z; {p} names the set of shifts:
    ``now`` or ``old``. ``before`` stands before each move, for each of its shifted axes.
    """

    start: tuple[str, ...]
    now: str
    old: str
    word: str
    before: str = ""
    again: tuple[str, ...]
    read: tuple[str, ...]
    loop: tuple[str, ...]
    subprogram: tuple[str, ...] = ()


def _fanuc_read() -> tuple[str, ...]:
    lines = ["#521=#511", "#522=#512", "#523=#513", "#509=0", "IF[#500NE1]GOTO{skip}"]
    for j in "123":
        lines += [
            f"#51{j}=#50{j}",
            f"IF[#51{j}GT#506]THEN#51{j}=#506",
            f"IF[#51{j}LT[0-#506]]THEN#51{j}=0-#506",
        ]
    return (*lines, "#509=#504", "N{skip}", "#507=#507+1")


def _heidenhain_read() -> tuple[str, ...]:
    lines = ["LBL 900", "Q72 = Q82", "Q73 = Q83", "Q74 = Q84", "Q99 = 0",
             "FN 10: IF +Q91 NE +1 GOTO LBL 907"]  # fmt: skip
    for j, first in ((2, 901), (3, 903), (4, 905)):
        lines += [
            f"Q8{j} = Q9{j}",
            f"FN 12: IF +Q8{j} LT +Q96 GOTO LBL {first}",
            f"Q8{j} = Q96",
            f"LBL {first}",
            f"FN 11: IF +Q8{j} GT +Q97 GOTO LBL {first + 1}",
            f"Q8{j} = Q97",
            f"LBL {first + 1}",
        ]
    return (*lines, "Q99 = Q95", "LBL 907", "Q87 = Q87 + 1", "LBL 0")


LED = {
    # R91 valid, R92 to R94 told, R95 status; R82 to R84 taken, R72 to R74 of the stop before.
    "siemens": Led(
        start=(
            "R96={l} ; largest correction, each axis",
            "R98={k} ; images of one stop where nothing is seen",
            "R91=0 R82=0 R83=0 R84=0 R72=0 R73=0 R74=0",
        ),
        now="R8",
        old="R7",
        word="{a}={v}+{p}{j}",
        again=("R97=0", "AGAIN_{n}:"),
        read=(
            "R72=R82 R73=R83 R74=R84 R99=0",
            "IF R91==1",
            "R82=BOUND(-R96,R96,R92) R83=BOUND(-R96,R96,R93) R84=BOUND(-R96,R96,R94)",
            "R99=R95",
            "ENDIF",
            "R97=R97+1",
        ),
        loop=("IF (R99==2) AND (R97<R98) GOTOB AGAIN_{n}",),
    ),
    # #500 valid, #501 to #503 told, #504 status; #511 to #513 taken, #521 to #523 before.
    "fanuc": Led(
        start=(
            "#506={l}(largest correction, each axis)",
            "#508={k}(images of one stop where nothing is seen)",
            *(f"#{number}=0" for number in (500, 511, 512, 513, 521, 522, 523)),
        ),
        now="#51",
        old="#52",
        word="{a}[{v}+{p}{j}]",
        again=("#507=0", "N{back}"),
        read=_fanuc_read(),
        loop=("IF[[#509EQ2]AND[#507LT#508]]GOTO{back}",),
    ),
    # Q91 valid, Q92 to Q94 told, Q95 status; Q82 to Q84 taken, Q72 to Q74 before; Q62 to Q64 sums.
    "heidenhain": Led(
        start=(
            "Q96 = {l} ; largest correction, each axis",
            "Q97 = 0 - Q96",
            "Q98 = {k} ; images of one stop where nothing is seen",
            *(f"Q{number} = 0" for number in (91, 82, 83, 84, 72, 73, 74)),
        ),
        now="Q8",
        old="Q7",
        before="Q6{j} = {p}{j}{s}{u}",
        word="{a}+Q6{j}",
        again=("Q87 = 0", "LBL {back}"),
        read=("CALL LBL 900",),
        loop=(
            "FN 10: IF +Q99 NE +2 GOTO LBL {skip}",
            "FN 12: IF +Q87 LT +Q98 GOTO LBL {back}",
            "LBL {skip}",
        ),
        subprogram=_heidenhain_read(),
    ),
}
FIRST = {"siemens": 2, "fanuc": 1, "heidenhain": 2}
"""Digit of X in the parameters' names; Y and Z follow."""
