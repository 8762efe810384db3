"""./omm calibrate --plan: the program touches the target named, once the probe's length is told."""

import re
import shutil
import subprocess

import pytest
import yaml

from omm_bringup.command_line import main
from omm_simulation.scenario import load_scenario

AT_Z = -300.0  # of the plate, and so of the dot to touch
PROBE_MM = 140.0
LINKS = ("machine", "a", "b", "c", "spindle")
JOINTS = (  # name, type, axis, limits
    ("X", "prismatic", "1 0 0", "-1", "3"),
    ("Y", "prismatic", "0 1 0", "-1", "2"),
    ("Z", "prismatic", "0 0 1", "-0.5", "1.5"),
    ("C", "revolute", "0 0 1", "-6.3", "6.3"),
)


def urdf():
    joints = [
        f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
        <axis xyz="{axis}"/><limit lower="{low}" upper="{high}" effort="0" velocity="1"/></joint>"""
        for (name, kind, axis, low, high), parent, child in zip(
            JOINTS, LINKS[:-1], LINKS[1:], strict=True
        )
    ]
    links = [f'<link name="{link}"/>' for link in LINKS]
    return "\n".join(['<robot name="mill">', *links, *joints, "</robot>"])


@pytest.fixture
def files(tmp_path):
    """Arguments for a plate of 16 targets under a mill whose spindle turns (C)."""
    targets = [
        {
            "id": 10 + 4 * i + j,
            "xyz_mm": [60.0 * i, 50.0 * j, 0.0],
            "dot_diameter_mm": 6.0,
            "sigma_xyz_mm": [0.05] * 3,
        }
        for i in range(4)
        for j in range(4)
    ]
    part = {"part": {"name": "plate"}, "target_family": "metashape12", "targets": targets}
    (tmp_path / "part.yaml").write_text(yaml.safe_dump(part))
    (tmp_path / "mill.urdf").write_text(urdf())
    (tmp_path / "machine.yaml").write_text("machine: {name: mill 1, urdf: mill.urdf}")
    camera = load_scenario("bench").calibration_file
    arguments = ["--part", tmp_path / "part.yaml", "--calibration", camera]
    arguments += ["--machine", tmp_path / "machine.yaml", "--part-at", 100, 200, AT_Z]
    return ["calibrate", "--plan", "--want", "0.5", *map(str, arguments)]


def interpreted(text, folder):
    (folder / "tool.tbl").write_text("")
    (folder / "p.ngc").write_text(text)
    done = subprocess.run(
        ["rs274", "-g", "-t", str(folder / "tool.tbl"), str(folder / "p.ngc")],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-500:] + done.stderr
    return done.stdout


def program_with(files, tmp_path, length):
    assert main([*files, "--out", str(tmp_path / "p.ngc")]) == 0
    text = (tmp_path / "p.ngc").read_text()
    assert text.count("#<_omm_probe_mm> = 0\n") == 1
    return text.replace("#<_omm_probe_mm> = 0\n", f"#<_omm_probe_mm> = {length}\n")


linuxcnc = pytest.mark.skipif(
    shutil.which("rs274") is None, reason="LinuxCNC's rs274 is not installed"
)


@linuxcnc
@pytest.mark.parametrize(("length", "said"), [(0, "no length"), (1500, "reach"), (-5, "no length")])
def test_nothing_is_touched_and_nothing_waits_without_a_length_that_fits(
    files, tmp_path, length, said
):
    run = interpreted(program_with(files, tmp_path, length), tmp_path)
    assert "STRAIGHT_PROBE" not in run
    assert "PROGRAM_STOP" not in run
    assert re.search(f'MESSAGE\\("target 1. is not touched: .*{said}', run)


@linuxcnc
@pytest.mark.parametrize("active", ["G49", "G43.1 Z12", "G92 Z1", "G10 L2 P1 X1 Y2 Z3 R30"])
def test_the_height_told_is_the_balls_whatever_offsets_are_active(files, tmp_path, active):
    text = program_with(files, tmp_path, PROBE_MM).replace("%\n", f"%\nG21\n{active}\n", 1)
    run = interpreted(text, tmp_path)
    assert run.count("STRAIGHT_PROBE") == 2
    assert run.count("PROGRAM_STOP") == 2
    # The interpreter has nothing to meet: both touches go to their end, 10 mm and 2 mm deeper.
    told = yaml.safe_load(re.search(r'LOG\("(touched: .*)"\)', run)[1])["touched"]
    assert told["z_mm"] == pytest.approx(AT_Z - 12.0, abs=1e-3)
    assert told["sigma_mm"] == 0.005
    assert f'MESSAGE("touched: {{target: {told["target"]}' in run


@linuxcnc
def test_an_axis_that_counts_downwards_tells_the_same_height(files, tmp_path):
    upwards = '<axis xyz="0 0 1"/><limit lower="-0.5" upper="1.5"'
    downwards = '<axis xyz="0 0 -1"/><limit lower="-1.5" upper="0.5"'
    (tmp_path / "mill.urdf").write_text(urdf().replace(upwards, downwards))
    run = interpreted(program_with(files, tmp_path, PROBE_MM), tmp_path)
    ends = [float(z) for z in re.findall(r"STRAIGHT_PROBE\([^,]+, [^,]+, ([^,]+),", run)]
    assert ends == [-(AT_Z + PROBE_MM - 10.0), -(AT_Z + PROBE_MM - 12.0)]
    told = yaml.safe_load(re.search(r'LOG\("(touched: .*)"\)', run)[1])["touched"]
    assert told["z_mm"] == pytest.approx(AT_Z - 12.0, abs=1e-3)


@linuxcnc
def test_the_probe_goes_across_far_out_and_down_only_above_the_dot(files, tmp_path):
    run = interpreted(program_with(files, tmp_path, PROBE_MM), tmp_path).split("PROGRAM_STOP()")
    number = int(re.search(r"put the touch probe|touched: \{target: (\d+)", run[2])[1])
    row, column = divmod(number - 10, 4)
    before, across, down = (
        [[float(v) for v in m.split(",")[:3]] for m in re.findall(r"STRAIGHT_\w+\((.*)\)", part)]
        for part in run
    )
    place = [100.0 + 60.0 * row, 200.0 + 50.0 * column]
    assert across[0] == [*place, before[-1][2]]
    assert across[0][2] >= max(z for *_, z in before[2:])
    assert across[-1] == [*place, AT_Z + PROBE_MM + 10.0]
    assert {tuple(at[:2]) for at in down} == {tuple(place)}
    assert down[-1][2] == before[-1][2]


def test_without_a_touch_planned_the_program_has_none(files, tmp_path):
    assert main([*files, "--touch", "0", "--out", str(tmp_path / "p.ngc")]) == 0
    assert "G38" not in (tmp_path / "p.ngc").read_text()


@pytest.mark.parametrize(
    ("control", "cycle"),
    [("siemens", "CYCLE978"), ("heidenhain", "TCH PROBE 427"), ("fanuc", "G31"), ("fagor", "G100")],
)
def test_templates_of_other_controls_say_it_in_comments_only(files, tmp_path, control, cycle):
    program = tmp_path / "program.txt"
    assert main([*files, "--control", control, "--out", str(program)]) == 0
    lines = [line for line in program.read_text().splitlines() if cycle in line]
    assert len(lines) == 1
    assert lines[0].startswith("(" if control == "fanuc" else ";")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--touch", "-1"], "sigma of a touched height"),
        (["--touch", "1e-200"], "sigma of a touched height"),
        (["--want", "0"], "above 0 px"),
        (["--control", "abacus"], "linuxcnc"),
        (["--machine", "{tmp}/bare.yaml"], "'urdf' is missing"),
        (["--machine", "{tmp}/none.yaml"], "no such file"),
        (["--part", "{tmp}/none.yaml"], "no such file"),
        (["--part", "{tmp}/two.yaml"], "at least 3 targets"),
        (["--part", "{tmp}/empty.yaml"], "at least one entry"),
        (["--calibration", "{tmp}/part.yaml"], "'camera' is missing"),
        (["--part-at", "9000", "0", "0"], "the machine reaches fewer than three"),
    ],
)
def test_what_cannot_be_planned_is_said_with_status_2_and_leaves_no_file(
    files, tmp_path, capsys, more, said
):
    part = yaml.safe_load((tmp_path / "part.yaml").read_text())
    (tmp_path / "two.yaml").write_text(yaml.safe_dump({**part, "targets": part["targets"][:2]}))
    (tmp_path / "empty.yaml").write_text(yaml.safe_dump({**part, "targets": []}))
    (tmp_path / "bare.yaml").write_text("machine: {name: mill 1}")
    out, program = tmp_path / "plan.json", tmp_path / "p.ngc"
    command = [*files, *(word.format(tmp=tmp_path) for word in more)]
    assert main([*command, "--json", str(out), "--out", str(program)]) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()
    assert not program.exists()


def test_a_wish_beyond_all_patterns_is_status_1_and_no_program(files, tmp_path, capsys):
    program = tmp_path / "p.ngc"
    assert main([*files, "--want", "1e-200", "--out", str(program)]) == 1
    assert "does NOT give" in capsys.readouterr().out
    assert not program.exists()
