"""Every axis that a control reports is known, or the pose is refused by name."""

from pathlib import Path

import pytest

from omm_cnc_bridge.control import ControlSample
from omm_cnc_bridge.controls.linuxcnc.joint_axes import joint_axes
from omm_cnc_bridge.judgement import Judge, SampleLimits
from omm_cnc_bridge.standstill import StandStillLimits
from omm_core.errors import DeviceError, InputError
from omm_core.machine.kinematics import Kinematics

MS = 1_000_000
URDF = Path(__file__).parents[1] / "machines" / "three_axis_mill.urdf"
XYZ = {"X": 1.0, "Y": 2.0, "Z": 3.0}


@pytest.fixture
def judge(tmp_path):
    def make(axes: str = "{}") -> Judge:
        path = tmp_path / "machine.yaml"
        path.write_text(f"machine: {{name: m, urdf: {URDF}}}\naxes: {axes}\n")
        limits = SampleLimits(age_ns=500 * MS, stamp_uncertainty_ns=10 * MS)
        return Judge(Kinematics.load(path), StandStillLimits(dwell_ns=100 * MS), limits)

    return make


def judged(judge: Judge, at_ms: int = 1000, **more):
    positions = more.pop("positions", XYZ)
    sample = ControlSample(
        stamp_ns=at_ms * MS, stamp_uncertainty_ns=MS, positions=positions, **more
    )
    return judge.judge(sample, at_ms * MS)


@pytest.mark.parametrize("axis", ["W", "A", "U", "X1"])
def test_an_axis_that_nobody_told_us_of_is_refused_by_name(judge, axis):
    answer = judged(judge(), positions={**XYZ, axis: 100.0})
    assert answer.machine_T_spindle is None
    assert f"axis {axis} is reported" in answer.refused
    assert "machine.yaml" in answer.refused


def test_an_ignored_axis_may_be_anywhere_move_and_be_unusable(judge):
    one = judge("{W: {ignored: true}, V: {ignored: true}}")
    for at in range(1000, 1301, 10):
        last = judged(one, at, positions={**XYZ, "W": float(at)}, unusable={"V": "BadNoData"})
    assert last.refused == ""
    assert last.machine_T_spindle.translation_mm.tolist() == [1.0, 2.0, 3.0]
    assert last.rest_since_ns == 1000 * MS


@pytest.mark.parametrize(
    ("apart_mm", "fine"), [(0.0, True), (0.04, True), (-0.06, False), (1.0, False)]
)
def test_a_second_drive_is_compared_with_its_tolerance(judge, apart_mm, fine):
    one = judge("{Y2: {follows: Y, tolerance_mm: 0.05}}")
    answer = judged(one, positions={**XYZ, "Y2": 2.0 + apart_mm})
    assert (answer.refused == "") is fine
    assert fine or "axis Y2 follows Y" in answer.refused


def test_a_second_drive_that_the_control_tells_of_needs_no_machine_yaml(judge):
    followers = {"Y2": "Y"}
    assert judged(judge(), positions={**XYZ, "Y2": 2.001}, followers=followers).refused == ""
    racked = judged(judge(), positions={**XYZ, "Y2": 3.0}, followers=followers)
    assert "1.0000 mm apart" in racked.refused


@pytest.mark.parametrize("axis", ["Z", "A"])
def test_an_unusable_axis_is_refused_with_its_reason(judge, axis):
    positions = {a: v for a, v in XYZ.items() if a != axis}
    answer = judged(judge(), positions=positions, unusable={axis: "'1,5' is not a number"})
    assert f"axis {axis}: '1,5' is not a number" in answer.refused


@pytest.mark.parametrize(
    "axes", ["{Y2: {follows: Y2}}", "{W: {ignored: 7}}", "{Y2: {follows: Y, ignored: true}}", "[X]"]
)
def test_a_machine_yaml_that_contradicts_itself_is_refused(judge, axes):
    with pytest.raises(InputError, match=r"machine\.yaml"):
        judge(axes)


@pytest.mark.parametrize(("leader", "words"), [("Q", "it has X, Y, Z"), ("y", "small letters")])
def test_a_drive_that_follows_an_axis_that_is_not_there_is_refused_at_the_start(
    judge, leader, words
):
    with pytest.raises(InputError, match=words):
        judge(f"{{Y2: {{follows: {leader}}}}}")
    judge("{Y2: {follows: Y}, Y3: {follows: Y2}}")


def test_a_drive_that_counts_the_other_way_is_refused_as_soon_as_it_shows(judge):
    one = judge("{Y2: {follows: Y}}")
    assert judged(one, 1000, positions={**XYZ, "Y": 0.0, "Y2": 0.0}).refused == ""
    assert "20.0000 mm apart" in judged(one, 1010, positions={**XYZ, "Y": 10.0, "Y2": -10}).refused


@pytest.mark.parametrize(
    ("given", "letters", "names", "followers"),
    [
        ((), "XYYZ", ("X", "Y", "Y2", "Z"), {"Y2": "Y"}),
        (("X", "Y", "Y", "Z"), "XYYZ", ("X", "Y", "Y2", "Z"), {"Y2": "Y"}),
        (("X", "Y", "Yb", "Z"), "XYYZ", ("X", "Y", "Yb", "Z"), {"Yb": "Y"}),
        (("X", "Y", "Y", "Z"), "XYZ", ("X", "Y", "Y2", "Z"), {"Y2": "Y"}),
        ((), "XXYYZ", ("X", "X2", "Y", "Y2", "Z"), {"X2": "X", "Y2": "Y"}),
        ((), "XYZBC", ("X", "Y", "Z", "B", "C"), {}),
    ],
)
def test_joints_of_one_letter_are_drives_of_one_axis(given, letters, names, followers):
    assert joint_axes(given, letters, len(names)) == (names, followers)


def test_names_that_do_not_fit_the_joints_are_refused_with_what_to_set():
    with pytest.raises(DeviceError, match="List 4 axes"):
        joint_axes(("X", "Y", "Z"), "XYYZ", 4)


def test_the_example_of_a_gantry_compares_its_drives_and_ignores_its_quill():
    machine = Kinematics.load(URDF.with_name("gantry_two_drives.yaml"))
    assert machine.rules.follows["Y2"].leader == "Y"
    assert machine.rules.ignored == {"W"}
