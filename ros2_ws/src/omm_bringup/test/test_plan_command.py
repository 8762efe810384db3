"""./omm plan: the contract's JSON, exit statuses, and files that are written or not."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml

from omm_bringup.command_line import main
from omm_core.machine.kinematics import Kinematics
from omm_simulation.scenario import load_scenario

URDF = """<robot name="mill">
  <link name="machine"/><link name="a"/><link name="b"/><link name="spindle"/>
  <joint name="X" type="prismatic"><parent link="machine"/><child link="a"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="3" effort="0" velocity="0.5"/></joint>
  <joint name="Y" type="prismatic"><parent link="a"/><child link="b"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="0" velocity="0.5"/></joint>
  <joint name="Z" type="prismatic"><parent link="b"/><child link="spindle"/>
    <axis xyz="0 0 1"/><limit lower="-0.5" upper="1.5" effort="0" velocity="0.5"/></joint>
</robot>
"""
MACHINE = """
machine: {name: mill 1, urdf: mill.urdf}
uncertainty: {stop_sigma_mm: 0.003, geometry_sigma_mm: 0.015, geometry_length_mm: 700}
axes:
  X: {velocity_mm_per_s: 1000, acceleration_mm_per_s2: 3000, jerk_mm_per_s3: 30000}
  Y: {velocity_mm_per_s: 1000, acceleration_mm_per_s2: 3000, jerk_mm_per_s3: 30000}
  Z: {velocity_mm_per_s: 1000, acceleration_mm_per_s2: 3000, jerk_mm_per_s3: 30000}
timing: {settling_s: 0.3, image_s: 0.5}
"""


@pytest.fixture
def files(tmp_path):
    """Arguments that name part, camera and machine; the part knows its nominal place."""
    bench = load_scenario("bench")
    part = yaml.safe_load(bench.part_file.read_text())
    for target in part["targets"]:
        target["sigma_xyz_mm"] = [0.02, 0.02, 0.02]
    part["nominal"] = {"translation_mm": [100, 200, -150], "euler_xyz_rad": [0, 0, 0.1]}
    (tmp_path / "part.yaml").write_text(yaml.safe_dump(part))
    (tmp_path / "mill.urdf").write_text(URDF)
    (tmp_path / "machine.yaml").write_text(MACHINE)
    arguments = ["--part", tmp_path / "part.yaml", "--calibration", bench.calibration_file]
    return [str(a) for a in (*arguments, "--machine", tmp_path / "machine.yaml")]


def test_a_plan_is_what_the_contract_says(files, tmp_path, capsys):
    out, program = tmp_path / "plan.json", tmp_path / "plan.ngc"
    more = ["--want", "0.05,0.06", "--json", str(out), "--out", str(program)]
    assert main(["plan", *files, *more]) == 0
    plan = json.loads(out.read_text())
    machine = Kinematics.load(tmp_path / "machine.yaml")
    ids = {t["id"] for t in yaml.safe_load((tmp_path / "part.yaml").read_text())["targets"]}
    for stop in plan["stops"]:
        pose = machine.machine_T_spindle(stop["axes"])
        told = stop["machine_T_spindle"]
        assert told["translation_mm"] == pytest.approx(pose.translation_mm, abs=1e-6)
        assert told["quaternion_xyzw"] == pytest.approx(pose.quaternion_xyzw(), abs=1e-9)
        assert set(stop["targets"]) <= ids
    covariance = np.array(plan["predicted"]["covariance"])
    U = np.array(plan["predicted"]["expanded_uncertainty"])
    assert covariance.shape == (7, 7)
    assert pytest.approx(2.0 * np.sqrt(np.diag(covariance))) == U
    assert U[3:6].max() <= 0.05
    assert 1e3 * U[:3].max() <= 0.06
    assert plan["seconds"] > 0.8 * len(plan["stops"])
    said = capsys.readouterr().out
    assert all(finding in said for finding in plan["findings"])
    asked = [line for line in program.read_text().splitlines() if line.startswith("M68 E0 Q")]
    assert len(asked) == plan["program"]["images"] == len(plan["stops"])


@pytest.mark.skipif(shutil.which("rs274") is None, reason="LinuxCNC's rs274 is not installed")
@pytest.mark.parametrize("more", [[], ["--search", "150"]])
def test_linuxcnc_reads_the_program_and_goes_to_the_stops(files, tmp_path, more):
    out, program = tmp_path / "plan.json", tmp_path / "plan.ngc"
    assert main(["plan", *files, *more, "--json", str(out), "--out", str(program)]) == 0
    (tmp_path / "tool.tbl").write_text("")
    done = subprocess.run(
        ["rs274", "-g", "-t", str(tmp_path / "tool.tbl"), str(program)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    stops = json.loads(out.read_text())["program"]["stops"]
    # Where nobody answers a look for the part, the program ends with it.
    for stop in stops[:1] if more else stops:
        x, y, z = (f"{stop['axes'][name]:.4f}" for name in "XYZ")
        assert f"STRAIGHT_FEED({x}, {y}, {z}," in done.stdout


def test_a_wish_that_cannot_be_reached_leaves_the_best_plan_and_no_program(files, tmp_path, capsys):
    out, program = tmp_path / "plan.json", tmp_path / "plan.ngc"
    more = ["--want-point", "0.005", "--json", str(out), "--out", str(program)]
    assert main(["plan", *files, *more]) == 1
    plan = json.loads(out.read_text())
    assert len(plan["stops"]) >= 8
    assert "ore or better targets" in plan["findings"][0]
    assert plan["findings"][0] in capsys.readouterr().err
    assert not program.exists()


def test_a_part_out_of_reach_leaves_json_with_the_reason(files, tmp_path):
    out = tmp_path / "plan.json"
    assert main(["plan", *files, "--part-at", "9000", "0", "0", "--json", str(out)]) == 1
    plan = json.loads(out.read_text())
    assert plan["stops"] == []
    assert "over its limit" in plan["findings"][0]


def test_picture_and_document_are_written_the_same_twice(files, tmp_path):
    for n in "12":
        more = ["--picture", str(tmp_path / f"{n}.png"), "--report", str(tmp_path / f"{n}.pdf")]
        assert main(["plan", *files, *more]) == 0
    assert (tmp_path / "1.pdf").read_bytes() == (tmp_path / "2.pdf").read_bytes()
    assert (tmp_path / "1.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("control", "limit"),
    [("siemens", "R96=20.000"), ("heidenhain", "Q96 = 20.000"), ("fanuc", "#506=20.000")],
)
def test_programs_of_three_other_controls_clamp_corrections_themselves(
    files, tmp_path, control, limit
):
    program = tmp_path / "program.txt"
    more = ["--control", control, "--limit", "20", "--out", str(program)]
    assert main(["plan", *files, *more]) == 0
    assert limit in program.read_text()


@pytest.mark.parametrize("control", ["siemens", "heidenhain", "fanuc", "fagor"])
def test_other_controls_get_every_stop(files, tmp_path, control):
    out, program = tmp_path / "plan.json", tmp_path / "program.txt"
    more = ["--control", control, "--limit", "0", "--json", str(out), "--out", str(program)]
    assert main(["plan", *files, *more]) == 0
    text = program.read_text().replace("+", "")
    assert "template" in text
    for stop in json.loads(out.read_text())["stops"]:
        assert " ".join(f"{n}{v:.4f}" for n, v in stop["axes"].items()) in text


@pytest.mark.parametrize(
    "more",
    [
        ["--control", "mazak", "--out", "PROGRAM"],
        ["--want=-1,2"],
        ["--bump", "0"],
        ["--limit", "-3"],
        ["--part-turned", "0", "0", "0"],
        ["--part-at", "0", "0", "0", "--near", "nowhere"],
        ["--near", "nowhere"],
    ],
)
def test_bad_input_writes_nothing(files, tmp_path, more):
    out = tmp_path / "plan.json"
    named = [str(tmp_path / "p.ngc") if word == "PROGRAM" else word for word in more]
    assert main(["plan", *files, *named, "--json", str(out)]) == 2
    assert not out.exists()


def test_a_part_without_a_whole_nominal_has_to_be_placed(files, tmp_path, capsys):
    part = yaml.safe_load(Path(files[1]).read_text())
    part["nominal"]["translation_mm"][1] = None
    Path(files[1]).write_text(yaml.safe_dump(part))
    assert main(["plan", *files]) == 2
    assert "--part-at" in capsys.readouterr().err
    assert main(["plan", *files, "--part-at", "100", "-1e2", "-150"]) == 0
