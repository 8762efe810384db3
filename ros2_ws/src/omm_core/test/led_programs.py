"""Just enough of three controls' languages to run the templates of their measuring programs."""

import re
from dataclasses import dataclass, field


@dataclass
class Run:
    """Variables, and where the axes were at each request, with its number."""

    values: dict[str, float] = field(default_factory=dict)
    axes: dict[str, float] = field(default_factory=dict)
    asked: list[tuple[int, dict[str, float]]] = field(default_factory=list)
    path: list[dict[str, float]] = field(default_factory=list)


def python_of(control: str, text: str) -> str:
    """Return an expression of a control in Python, over ``v`` (variables by name)."""
    text = text.replace("[", "(").replace("]", ")").replace("<>", "!=")
    for word, operator in (("EQ", "=="), ("NE", "!="), ("GT", ">"), ("LT", "<")):
        text = re.sub(rf"(?<=[\d)]) *{word} *", operator, text)
    text = re.sub(r"(?<=\)) ?AND ?(?=\()", " and ", text)
    text = text.replace("BOUND(", "bound(")
    letter = {"siemens": "R", "fanuc": "#", "heidenhain": r"Q"}[control]
    return re.sub(rf"{letter}(\d+)", r"v['\1']", text)


def bound(low: float, high: float, value: float) -> float:
    return min(max(value, low), high)


def value_of(control: str, text: str, run: Run) -> float:
    return eval(python_of(control, text), {"v": run.values, "bound": bound})  # our own text


ANSWERED = {
    "siemens": r"IF R11<>\d+ GOTOB WAIT_\d+",
    "fanuc": r"WHILE\[#1000EQ0\]DO1",
    "heidenhain": r"FN 20: WAIT FOR M4800==1",
}
NUMBER = {"siemens": "10", "fanuc": "1133", "heidenhain": "90"}
TOLD = {
    "siemens": ("91", ("92", "93", "94"), "95"),
    "fanuc": ("500", ("501", "502", "503"), "504"),
    "heidenhain": ("91", ("92", "93", "94"), "95"),
}


def run_program(control: str, text: str, answers) -> Run:
    """Run a program; each request is answered with the next (shift, status, valid)."""
    lines = [re.sub(r"\(.*?\)$|;.*$", "", line).strip() if control != "siemens" else
             line.split(";")[0].strip() for line in text.splitlines()]  # fmt: skip
    run, answers, at, back = Run(), iter(answers), 0, []
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
        elif line == "CALL LBL 900":
            back.append(at)
            at = lines.index("LBL 900")
        elif line == "LBL 0":
            at = back.pop()
        else:
            at = _one(control, line, lines, at, run)
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
    if then := re.fullmatch(r"IF(.*)THEN#(\d+)=(.*)", line):
        if value_of(control, then[1], run):
            run.values[then[2]] = value_of(control, then[3], run)
        return at
    if line.startswith("IF "):  # Siemens: up to ENDIF
        return at if value_of(control, line[3:], run) else lines.index("ENDIF", at) + 1
    if move := re.match(r"(SUPA G1|G53 G0|L) ([XYZ].*?)( F\S*| FMAX M91)?$", line):
        for name, word in re.findall(r"([XYZ])(\S+)", move[2]):
            run.axes[name] = value_of(control, word.lstrip("="), run)
        run.path.append(dict(run.axes))
    elif re.match(r"[R#Q]\d+ ?=", line):
        for name, word in re.findall(r"[R#Q](\d+) ?= ?(.*?)(?= R\d+=|$)", line):
            run.values[name] = value_of(control, word, run)
    return at
