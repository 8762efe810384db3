"""Kinematics against poses worked out by hand, and the laws that every machine obeys."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omm_core.errors import InputError
from omm_core.machine.kinematics import Kinematics, Side

MACHINES = Path(__file__).parents[1] / "machines"
EXACT = {"rtol": 0.0, "atol": 1e-9}
QUARTER = math.pi / 2


def machine(name: str) -> Kinematics:
    return Kinematics.load(MACHINES / f"{name}.urdf")


# Machine, axis positions, then worked by hand: where the spindle is, and where its x and z point.
BY_HAND = [
    ("three_axis_mill", {"X": 10, "Y": -20, "Z": 30}, (10, -20, 30), (1, 0, 0), (0, 0, 1)),
    # The head's pivot is 250 above the spindle's origin; C turns it about itself.
    ("gantry_bc_head", dict(X=0, Y=0, Z=0, B=0, C=0), (0, 0, 0), (1, 0, 0), (0, 0, 1)),
    ("gantry_bc_head", dict(X=5, Y=6, Z=7, B=0, C=QUARTER), (5, 6, 7), (0, 1, 0), (0, 0, 1)),
    # B by 90°: the spindle's nose swings from below the pivot to -X of it, its z points to +X.
    ("gantry_bc_head", dict(X=0, Y=0, Z=0, B=QUARTER, C=0), (-250, 0, 250), (0, 0, -1), (1, 0, 0)),
    (
        "gantry_bc_head",
        dict(X=1, Y=2, Z=3, B=QUARTER, C=QUARTER),
        (1, -248, 253),
        (0, 0, -1),
        (0, 1, 0),
    ),
    # B by 30°: sin and cos of it by hand.
    (
        "gantry_bc_head",
        dict(X=0, Y=0, Z=0, B=math.pi / 6, C=0),
        (-125, 0, 250 - 125 * math.sqrt(3)),
        (math.sqrt(3) / 2, 0, -0.5),
        (0.5, 0, math.sqrt(3) / 2),
    ),
    # A by 90°: the nose swings from -Z of the pivot (200 away) to +Y, its z points to -Y.
    (
        "travelling_column_ac_head",
        dict(X=0, Y=0, Z=0, A=QUARTER, C=0),
        (0, 200, 200),
        (1, 0, 0),
        (0, -1, 0),
    ),
    (
        "travelling_column_ac_head",
        dict(X=100, Y=0, Z=0, A=QUARTER, C=QUARTER),
        (-100, 0, 200),
        (0, 1, 0),
        (1, 0, 0),
    ),
    # The table turns by C = +90° against Z; on it, the tool has turned by +90° about Z.
    ("table_table", dict(X=100, Y=0, Z=50, A=0, C=QUARTER), (0, 100, 50), (0, 1, 0), (0, 0, 1)),
    # A by +90° about a line 120 below the face: the tool, 50 above the face, is 170 from that line.
    ("table_table", dict(X=0, Y=0, Z=50, A=QUARTER, C=0), (0, -170, -120), (1, 0, 0), (0, -1, 0)),
    (
        "table_table",
        dict(X=10, Y=0, Z=50, A=QUARTER, C=QUARTER),
        (170, 10, -120),
        (0, 1, 0),
        (1, 0, 0),
    ),
    ("right_angle_head", dict(X=0, Y=0, Z=0), (180, 0, -310), (0, 0, 1), (-1, 0, 0)),
]


@pytest.mark.parametrize(("name", "axes", "origin", "x", "z"), BY_HAND)
def test_pose_equals_the_one_worked_by_hand(name, axes, origin, x, z):
    pose = machine(name).machine_T_spindle(axes)
    np.testing.assert_allclose(pose.translation_mm, origin, **EXACT)
    np.testing.assert_allclose(pose.rotation[:, 0], x, **EXACT)
    np.testing.assert_allclose(pose.rotation[:, 2], z, **EXACT)


angle, length = st.floats(-1.9, 1.9), st.floats(-300.0, 300.0)


@settings(max_examples=50, deadline=None)
@given(length, length, length, angle, angle)
def test_head_equals_the_formula_of_5axiskins(x, y, z, b, c):
    """LinuxCNC's emc/kinematics/5axiskins.c, kinematicsForward, at W = 0; B is left-handed."""
    pivot, polar = 250.0, math.pi - b
    expected = (
        x + pivot * math.sin(polar) * math.cos(c),
        y + pivot * math.sin(polar) * math.sin(c),
        z + pivot + pivot * math.cos(polar),
    )
    axes = {"X": x, "Y": y, "Z": z, "B": -b, "C": c}
    pose = machine("gantry_bc_head").machine_T_spindle(axes)
    np.testing.assert_allclose(pose.translation_mm, expected, **EXACT)


@settings(max_examples=50, deadline=None)
@given(length, length, length, angle, angle, angle)
def test_a_turning_table_is_a_turning_tool(x, y, z, a, c, more):
    """Turning the table by C turns everything about the table's axis, as the part sees it."""
    table = machine("table_table")
    pose = table.machine_T_spindle({"X": x, "Y": y, "Z": z, "A": a, "C": c})
    turned = table.machine_T_spindle({"X": x, "Y": y, "Z": z, "A": a, "C": c + more})
    s, k = math.sin(more), math.cos(more)
    rz = np.array([[k, -s, 0], [s, k, 0], [0, 0, 1]])
    np.testing.assert_allclose(turned.rotation, rz @ pose.rotation, **EXACT)
    np.testing.assert_allclose(turned.translation_mm, rz @ pose.translation_mm, **EXACT)


@pytest.mark.parametrize("name", ["gantry_bc_head", "travelling_column_ac_head", "table_table"])
@pytest.mark.parametrize("turns_with_part", [False, True])
@settings(max_examples=25, deadline=None)
@given(length, length, length, angle, angle, st.floats(0.0, 400.0))
def test_axes_are_found_from_the_tool_point(name, turns_with_part, x, y, z, first, second, tool):
    m = machine(name)
    rotary = dict(zip(sorted(m.rotary), (first, second), strict=True))
    axes = {"X": x, "Y": y, "Z": z, **rotary}
    pose = m.machine_T_spindle(axes)
    if not turns_with_part:  # what a control tells that knows nothing of the table
        standing = {**axes, **{a.name: 0.0 for a in m.axes if a.side is Side.PART}}
        pose = m.machine_T_spindle(standing)
    p_tool_mm = pose.translation_mm - tool * pose.rotation[:, 2]
    found = m.axes_at_tool_point(rotary, p_tool_mm, tool, turns_with_part=turns_with_part)
    assert found == pytest.approx(axes, abs=1e-9)


def test_limits_are_told_with_axis_and_unit():
    told = machine("gantry_bc_head").out_of_limits({"X": 11000.5, "Y": 0, "Z": 0, "B": 2.0, "C": 0})
    assert len(told) == 2
    assert "X = 11000.5000 mm is outside -1000.0000 … 11000.0000" in told
    assert told[1].startswith("B = 2.0000 rad")


def test_missing_and_undefined_positions_are_refused():
    mill = machine("three_axis_mill")
    with pytest.raises(InputError, match="position of axis Z"):
        mill.machine_T_spindle({"X": 0.0, "Y": 0.0})
    with pytest.raises(InputError, match="position of axis Y"):
        mill.machine_T_spindle({"X": 0.0, "Y": math.nan, "Z": 0.0})


LIMIT = '<limit lower="0" upper="1"/>'


def joint(kind: str, more: str = "", parent: str = "machine") -> str:
    ends = f'<parent link="{parent}"/><child link="spindle"/>'
    return f'<joint name="X" type="{kind}">{ends}{more}</joint>'


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("<robot", "Expected XML"),
        ("<mill/>", "element robot"),
        ('<robot name="r"><link name="machine"/></robot>', "link named spindle"),
        (joint("prismatic"), "limits of joint X"),
        (joint("planar", LIMIT), "got planar"),
        (joint("prismatic", LIMIT, "column"), "column is not"),
        (joint("fixed"), "Expected axes"),
        (joint("prismatic", LIMIT + '<mimic joint="Y"/>'), "mimic"),
        (joint("prismatic", LIMIT + '<axis xyz="0 0 0"/>'), "a direction"),
        (joint("prismatic", LIMIT + '<origin xyz="1 2"/>'), "three"),
        (joint("prismatic", '<limit lower="1" upper="0"/>'), "lower <"),
    ],
)
def test_a_file_that_is_no_machine_is_refused_by_name(tmp_path, text, complaint):
    path = tmp_path / "machine.urdf"
    links = '<link name="machine"/><link name="spindle"/>'
    whole = f'<robot name="r">{links}{text}</robot>' if text.startswith("<joint") else text
    path.write_text(whole)
    with pytest.raises(InputError, match=complaint) as refused:
        Kinematics.load(path)
    assert "machine.urdf" in str(refused.value)


def test_an_axis_that_moves_spindle_and_part_together_is_refused(tmp_path):
    path = tmp_path / "machine.urdf"
    path.write_text(
        '<robot name="r"><link name="machine"/><link name="bed"/><link name="spindle"/>'
        '<link name="part_carrier"/>'
        '<joint name="U" type="continuous"><parent link="machine"/><child link="bed"/></joint>'
        '<joint name="X" type="continuous"><parent link="bed"/><child link="spindle"/></joint>'
        '<joint name="C" type="continuous"><parent link="bed"/><child link="part_carrier"/>'
        "</joint></robot>"
    )
    with pytest.raises(InputError, match="U, which moves both"):
        Kinematics.load(path)
