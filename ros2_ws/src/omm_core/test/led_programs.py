"""Just enough of four controls' languages to run the templates of their measuring programs.

Strict: a line that is not known, or that the control would refuse in its state, fails. What moves
an axis is modelled with the units, distance mode, tool length and transformation that are active.
Known of the controls by their manuals only.
"""

import math
import re
from dataclasses import dataclass, field

INCH = 25.4
GROUPS = {  # by control: numbers of the G codes, in the order in which Siemens counts them
    "siemens": {"unit": (70, 71, 700, 710), "distance": (90, 91), "feed": (93, 94, 95)},
    "fanuc": {"unit": (20, 21), "distance": (90, 91), "feed": (93, 94, 95)},
    "fagor": {"unit": (70, 71), "distance": (90, 91), "feed": (93, 94, 95)},
    "heidenhain": {},
}
SIEMENS_GROUPS = {13: "unit", 14: "distance", 15: "feed"}
MODAL = {"4006": "unit", "4003": "distance", "4005": "feed"}


@dataclass
class Run:
    """Variables, the modal state, and where the axes were at each request, with its number.

    ``length_mm`` of the tool counts while ``tool`` (D, H) is not 0; ``suspended``: by Fanuc's G53.
    ``transformed``: TRAORI, G43.4, M128. ``tilted``: G68.2, PLANE. ``inch_machine``: Siemens.
    """

    values: dict[str, float] = field(default_factory=dict)
    axes: dict[str, float] = field(default_factory=dict)
    asked: list[tuple[int, dict[str, float]]] = field(default_factory=list)
    path: list[dict[str, float]] = field(default_factory=list)
    g: dict[str, int] = field(default_factory=dict)
    tool: int = 0
    length_mm: float = 0.0
    suspended: bool = False
    transformed: bool = False
    tilted: bool = False
    radius: bool = False
    inch_machine: bool = False
    feeds: list[float] = field(default_factory=list)
    alarm: str = ""

    def unit(self) -> float:
        """Of lengths in the program, mm."""
        return INCH if self.g.get("unit") in (70, 700, 20) else 1.0

    def system_unit(self) -> float:
        """Of Siemens' feed and system variables, mm: G70 and G71 leave them to the machine."""
        if self.g["unit"] in (700, 710):
            return self.unit()
        return INCH if self.inch_machine else 1.0


def python_of(control: str, text: str) -> str:
    """Return an expression of a control in Python, over ``v`` (variables by name)."""
    text = text.replace("[", "(").replace("]", ")").replace("<>", "!=")
    for word, operator in (("EQU", "=="), ("EQ", "=="), ("NE", "!="), ("GT", ">"), ("LT", "<")):
        text = re.sub(rf"(?<=[\d)]) *{word} *", operator, text)
    text = re.sub(r"(?<=\)) ?AND ?(?=\()", " and ", text)
    text = text.replace("BOUND(", "bound(")
    letter = {"siemens": "R", "fanuc": "#", "heidenhain": r"Q", "fagor": "P"}[control]
    return re.sub(rf"{letter}(\d+)", r"v['\1']", text)


def bound(low: float, high: float, value: float) -> float:
    return min(max(value, low), high)


def value_of(control: str, text: str, run: Run) -> float:
    known = dict(run.values)
    if control == "fanuc":
        known |= {str(5021 + i): run.axes.get(a, 0.0) / run.unit() for i, a in enumerate("XYZ")}
        known |= {name: run.g[group] for name, group in MODAL.items() if group in run.g}
        known |= {"4008": 43.4 if run.transformed else 43 if run.tool else 49}
        known |= {"4016": 68.2 if run.tilted else 69}
    text = _system_variables(text, run) if control in ("siemens", "fagor") else text
    return eval(python_of(control, text), {"v": known, "bound": bound})  # our own text


def _system_variables(text: str, run: Run) -> str:
    """Siemens' and Fagor's, replaced by their values."""
    system_unit = run.system_unit() if "AA_IM" in text else 1.0
    text = re.sub(r"\$AA_IM\[(\w)\]", lambda m: repr(run.axes[m[1]] / system_unit), text)
    text = re.sub(r"V\.A\.TPOS\.(\w)", lambda m: repr(run.axes[m[1]] / run.unit()), text)
    text = text.replace("$P_TRAFO", str(24 if run.transformed else 0))
    text = text.replace("$P_TOOL", str(run.tool))
    return re.sub(r"\$P_GG\[(\d+)\]", lambda m: str(_number_in_group(int(m[1]), run)), text)


def _number_in_group(group: int, run: Run) -> int:
    name = SIEMENS_GROUPS[group]
    return GROUPS["siemens"][name].index(run.g[name]) + 1


ANSWERED = {
    "siemens": r"IF R11<>\d+ GOTOB WAIT_\d+",
    "fanuc": r"WHILE\[#1000EQ0\]DO1",
    "heidenhain": r"FN 20: WAIT FOR M4800==1",
    "fagor": r"#WAIT FOR \[V\.PLC\.M1002 EQ 1\]",
}
NUMBER = {"siemens": "10", "fanuc": "1133", "heidenhain": "90", "fagor": "R101"}
TOLD = {
    "siemens": ("91", ("92", "93", "94"), "95"),
    "fanuc": ("500", ("501", "502", "503"), "504"),
    "heidenhain": ("91", ("92", "93", "94"), "95"),
    "fagor": ("-", ("-", "-", "-"), "-"),
}
STARTED = {
    "siemens": {"unit": 71, "distance": 90, "feed": 94},
    "fanuc": {"unit": 21, "distance": 90, "feed": 94},
    "fagor": {"unit": 71, "distance": 90, "feed": 94},
    "heidenhain": {},
}
NOTHING = (  # dwells, answers of the PLC, marks
    r"",
    r"STOPRE",
    r"ENDIF|\$ENDIF",
    r"\w+:|LBL \d+|N\d+",
    r"G4 [FXK][\d.]+",
    r"CYCL DEF 9\.0 DWELL TIME",
    r"CYCL DEF 9\.1 DWELL [\d.]+",
    r"FN 19: PLC = .*",
    r"FN 20: WAIT FOR M4800==0",
    r"WHILE\[#1000EQ1\]DO1",
    r"END1",
    r"#WAIT FOR \[V\.PLC\.M1002 EQ 0\]",
    r"V\.PLC\.M\d+=[01]",
    r"BEGIN PGM OMM MM",
    r"%|O9101",
)


def run_program(control: str, text: str, answers=(), start: Run | None = None) -> Run:
    """Run a program; each request is answered with the next (shift, status, valid)."""
    lines = [re.sub(r"\(.*?\)$|;.*$", "", line).strip() if control == "fanuc" else
             line.split(";")[0].strip() for line in text.splitlines()]  # fmt: skip
    run = start or Run(g=dict(STARTED[control]), axes={"X": 0.0, "Y": 0.0, "Z": 0.0})
    answers, at, back = iter(answers), 0, []
    valid, shifts, status = TOLD[control]
    run.values.update(dict.fromkeys((valid, *shifts, status), 0.0))
    for _ in range(5000):
        line = lines[at]
        at += 1
        if re.fullmatch(ANSWERED[control], line):
            run.asked.append((int(run.values[NUMBER[control]]), dict(run.axes)))
            shift, told, holds = next(answers, ((0.0, 0.0, 0.0), 0, False))
            run.values.update(zip(shifts, map(float, shift)))
            run.values.update({status: float(told), valid: float(holds)})
        elif line == "M30":
            return run
        elif line == "STOP" or line.startswith("MSG("):
            run.alarm = line
        elif line == "CALL LBL 900":
            back.append(at)
            at = lines.index("LBL 900")
        elif line == "LBL 0":
            at = back.pop()
        else:
            at = _one(control, line, lines, at, run)
        if run.alarm:  # as the operator reads it, with the comment before
            run.alarm = "".join(text.splitlines()[max(0, at - 2) : at])
            return run
    raise AssertionError("the program does not end")


def _one(control, line, lines, at, run) -> int:
    jump = re.fullmatch(r"IF ?(.*?) ?GOTOB? ?(\w+)", line) or re.fullmatch(
        r"FN \d+: IF (.*) GOTO LBL (\w+)", line
    )
    if jump:
        label = {"siemens": "{}:", "fanuc": "N{}", "heidenhain": "LBL {}"}[control]
        if value_of(control, jump[1], run):
            return lines.index(label.format(jump[2]))
        return at
    if then := re.fullmatch(r"IF(\[.*\])THEN#(\d+)=(.*)", line):
        if value_of(control, then[1], run):
            run.values[then[2]] = value_of(control, then[3], run)
            run.alarm = line if then[2] == "3000" else ""
        return at
    if block := re.fullmatch(r"\$?IF (.*)", line):  # up to ENDIF
        ends = "$ENDIF" if control == "fagor" else "ENDIF"
        return at if value_of(control, block[1], run) else lines.index(ends, at) + 1
    if any(re.fullmatch(known, line) for known in NOTHING):
        return at
    if not (_moved(control, line, run) or _state(control, line, run) or _set(control, line, run)):
        raise AssertionError(f"{control}: {line!r} is not known")
    return at


MOVES = {
    "siemens": r"SUPA G1 (.*?) F=R1",
    "fanuc": r"G53 G0 (.*)",
    "heidenhain": r"L (.*?)( R0)? FMAX M91",
    "fagor": r"#MCS G1 (.*?) F(\d+)",
}


def _moved(control, line, run) -> bool:
    """Carry out a move in machine coordinates, as the state has it."""
    move = re.fullmatch(MOVES[control], line)
    if not move:
        return False
    assert not run.transformed, f"{line!r}: the axes are those of a transformation"
    assert not run.tilted, f"{line!r}: the plane is tilted"
    if control == "fanuc":
        assert run.g["distance"] == 90, "G53 under G91 is refused"
    before = dict(run.axes)
    for name, word in re.findall(r"([A-CU-Z])(\S+)", move[1]):
        value = value_of(control, word.lstrip("="), run)
        turns = name in "ABC"
        value *= 1.0 if turns else run.unit()
        if run.g.get("distance") == 91:
            value += before[name]
        if name == "Z" and run.tool and control == "siemens":
            value += run.length_mm  # SUPA leaves the tool length
        if name == "Z":
            run.suspended = run.suspended or (control == "fanuc" and run.tool != 0)
        run.axes[name] = value
    assert control != "heidenhain" or move[2] or not run.radius, "radius compensation is active"
    run.path.append(dict(run.axes))
    if control == "siemens":
        run.feeds.append(run.values["1"] * run.system_unit())
    return True


def _state(control, line, run) -> bool:
    """Carry out what changes the modal state: G, D, and G[group] of Siemens."""
    if by_number := re.fullmatch(r"G\[(\d+)\]=(R\d+)", line):
        group = SIEMENS_GROUPS[int(by_number[1])]
        number = int(value_of(control, by_number[2], run))
        run.g[group] = GROUPS["siemens"][group][number - 1]
        return True
    if tool := re.fullmatch(r"D=?(\w+)", line):
        run.tool = int(value_of(control, tool[1], run))
        return True
    if control == "fanuc":
        line = re.sub(r"G(#\d+)", lambda m: f"G{int(value_of(control, m[1], run))}", line)
    if not re.fullmatch(r"G\d+( G\d+)*", line):
        return False
    for number in map(int, re.findall(r"\d+", line)):
        if number == 49:  # alone in a block it moves the axis
            if run.tool:
                run.axes["Z"] -= run.length_mm
                run.path.append(dict(run.axes))
            run.tool = 0
            continue
        group = next((k for k, codes in GROUPS[control].items() if number in codes), None)
        assert group is not None, f"G{number} is not known"
        run.g[group] = number
    return True


def _set(control, line, run) -> bool:
    """Carry out assignments."""
    if plc := re.fullmatch(r"V\.PLC\.(R\d+)=(\d+)", line):
        run.values[plc[1]] = float(plc[2])
        return True
    read = re.fullmatch(r"FN 18: SYSREAD Q(\d+) = ID(\d+) NR(\d+)(?: IDX(\d+))?", line)
    if read:
        values = {("210", "6"): -1.0 * run.tilted, ("280", "1"): -1.0 * run.transformed}
        if (read[2], read[3]) == ("240", "1"):
            values["240", "1"] = run.axes["XYZABCUVW"[int(read[4]) - 1]]
        run.values[read[1]] = values[read[2], read[3]]
        return True
    if not re.match(r"[R#Q]\d+ ?=", line):
        return False
    for name, word in re.findall(r"[R#Q](\d+) ?= ?(.*?)(?= R\d+=|$)", line):
        run.values[name] = value_of(control, word, run)
        assert math.isfinite(run.values[name])
    return True
