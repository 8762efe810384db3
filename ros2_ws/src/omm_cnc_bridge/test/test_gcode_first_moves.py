"""The written program's first moves and what it leaves behind, as LinuxCNC reads it."""

import shutil
import subprocess

import numpy as np
import pytest

from omm_core.machine.kinematics import Kinematics
from omm_core.machine.urdf import Joint, Robot
from omm_core.planning.linuxcnc_program import linuxcnc_program
from omm_core.planning.pattern import Stop, backing_off
from omm_core.planning.program import ProgramOptions, make_program

STOPS = [
    Stop(target_id=i // 2, spindle_in_machine_mm=np.array([20.0 + i, 10.0 + i, 50.0 - i]))
    for i in range(4)
]
DOWN = np.eye(3)
TO_FRONT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # spindle z is machine y
UP_SIDE_DOWN = np.diag([1.0, -1.0, -1.0])


def machine(rotation) -> Kinematics:
    """Three linear axes X, Y, Z and a spindle that is turned on them."""
    links = ("machine", "a", "b", "c", "spindle")
    joints = [
        Joint(
            name=name, movable=True, rotary=False, parent=links[i], child=links[i + 1],
            origin=np.eye(4), axis=np.eye(3)[i], lower=-1e4, upper=1e4,
        )
        for i, name in enumerate("XYZ")
    ]  # fmt: skip
    turned = np.eye(4)
    turned[:3, :3] = rotation
    joints.append(
        Joint(
            name="head", movable=False, rotary=False, parent="c", child="spindle",
            origin=turned, axis=np.eye(3)[0], lower=0.0, upper=0.0,
        )
    )  # fmt: skip
    return Kinematics(Robot(name="mill", root="machine", links=links, joints=tuple(joints)))


def measuring_program(stops, rotation, options, **more) -> str:
    gone_to = backing_off(stops, options.retract_mm * rotation[:, 2])
    return linuxcnc_program(make_program(machine(rotation), gone_to, options, **more))


def moves(text: str) -> list[dict[str, float]]:
    """Axis words of each G53 block."""
    blocks = [line for line in text.splitlines() if line.startswith("G53")]
    return [
        {word[0]: float(word[1:]) for word in block.split()[2:] if word[0] in "XYZ"}
        for block in blocks
    ]


@pytest.mark.parametrize(
    ("rotation", "axis", "clear", "condition"),
    [
        (DOWN, "Z", 150.0, "#<_abs_z> LT 150.0000"),
        (TO_FRONT, "Y", 113.0, "#<_abs_y> LT 113.0000"),
        (UP_SIDE_DOWN, "Z", -53.0, "#<_abs_z> GT -53.0000"),
    ],
)
def test_the_spindle_goes_out_along_the_tool_then_across_then_in(rotation, axis, clear, condition):
    text = measuring_program(STOPS, rotation, ProgramOptions(retract_mm=100.0))
    out, across, before_first = moves(text)[:3]
    assert condition in text
    assert out == {axis: clear}
    assert axis not in across
    assert len(across) == 2
    assert across.items() <= before_first.items()


def test_the_state_is_restored_however_the_program_ends():
    lines = measuring_program(STOPS, DOWN, ProgramOptions()).splitlines()
    assert lines.index(next(line for line in lines if line.startswith("M70"))) < lines.index(
        "G21 G90 G94 G40 G17"
    )
    ends = [i for i, line in enumerate(lines) if line == "M2"]
    assert len(ends) == len(STOPS) + 1
    assert all(lines[i - 1] == "M72" for i in ends)


def interpreted(text: str, folder) -> str:
    path = folder / "measure.ngc"
    path.write_text(text)
    done = subprocess.run(
        ["rs274", "-g", "-t", str(folder / "tool.tbl"), str(path)],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-500:] + done.stderr
    return done.stdout


ACTIVE = ["G49", "G43.1 Z12", "G92 Z1", "G10 L2 P1 X1 Y2 Z3 R30", "G52 X5", "T1 M6\nG43 H1"]


@pytest.mark.skipif(shutil.which("rs274") is None, reason="LinuxCNC's rs274 is not installed")
@pytest.mark.parametrize("active", ACTIVE)
def test_linuxcnc_goes_to_the_same_places_whatever_is_active_and_gives_it_back(tmp_path, active):
    program = measuring_program(STOPS, DOWN, ProgramOptions(retract_mm=100.0)).strip("%\n")
    wanted = moves(program)
    program = program.replace("M66 P0 L3", "M66 P0 L0").removesuffix("M2")
    blocks = [
        f"{line}\n(PRINT,at #<_abs_x> #<_abs_y> #<_abs_z>)" if line.startswith("G53") else line
        for line in program.splitlines()
    ]
    (tmp_path / "tool.tbl").write_text("T1 P1 Z25 D5\n")
    told = interpreted("\n".join(["G20", active, *blocks, "M2"]) + "\n", tmp_path).splitlines()
    places = [[float(word) for word in line.split()[1:]] for line in told if line[:3] == "at "]
    assert len(places) == len(wanted)
    for place, words in zip(places, wanted, strict=True):
        assert {a: v for a, v in zip("XYZ", place) if a in words} == pytest.approx(words)
    lengths = {line.split("OFFSET", 1)[1] for line in told if "TOOL_LENGTH_OFFSET" in line}
    assert len(lengths) == ("G43" in active or active == "G49")
    units = [line.split("UNITS_")[-1] for line in told if "USE_LENGTH_UNITS" in line]
    assert units[-3:] == ["INCHES)", "MM)", "INCHES)"]
