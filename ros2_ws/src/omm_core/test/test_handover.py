"""A control's words, turned back into a pose by another formula, are the part's pose.

Poses, points and angles: worked by hand for this project (pose A: large angles, B: small ones);
read-back of CROT: SINUMERIK manual. Rotations here come from quaternions, not from matrices.
"""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omm_core.alignment import angles
from omm_core.alignment.controls import CONTROLS
from omm_core.alignment.handover import Box, hand_over
from omm_core.errors import InputError, MeasurementError
from omm_core.geometry import RigidTransform

A = RigidTransform.from_euler_xyz_rad(*np.radians([10.0, 20.0, 30.0]), [100.0, 200.0, 50.0])
B = RigidTransform.from_euler_xyz_rad(0.002, -0.003, 0.004, [812.345, -410.250, 155.020])
POINTS = {
    "A": (A, [400, -150, 80], [521.946298629, 256.996171167, -37.251117733]),
    "B": (B, [1500, 1000, 0], [2308.320268803, 595.739933028, 161.519982917]),
}
BOX_A = Box(low_mm=np.zeros(3), high_mm=np.array([400.0, 200.0, 0.0]), source="test")
BOX_B = Box(low_mm=np.zeros(3), high_mm=np.array([1500.0, 1000.0, 0.0]), source="test")
NUMBER = r"([-+]?\d+\.\d+)"
# Order of fixed axes, as (axis, place of the angle) from the first turn to the last.
ORDER = {
    "linuxcnc": ((2, 0),),
    "siemens": ((0, 0), (1, 1), (2, 2)),
    "heidenhain": ((0, 0), (1, 1), (2, 2)),
    "fanuc": ((2, 2), (0, 1), (2, 0)),
    "fagor": ((2, 2), (1, 1), (0, 0)),
}


def _turned(point: np.ndarray, axis: int, angle_deg: float) -> np.ndarray:
    """Turn by a quaternion: v + 2 w (u x v) + 2 u x (u x v)."""
    half = math.radians(angle_deg) / 2.0
    u = np.zeros(3)
    u[axis] = math.sin(half)
    once = np.cross(u, point)
    return point + 2.0 * math.cos(half) * once + 2.0 * np.cross(u, once)


def _numbers(control: str, text: str) -> tuple[list[float], list[float]]:
    """Read offset and angles out of the lines that are no comments."""
    said = "\n".join(line for line in text.splitlines() if line[0] not in ";(")
    patterns = {
        "linuxcnc": rf"X{NUMBER} Y{NUMBER} Z{NUMBER} R{NUMBER}",
        "siemens": rf"CTRANS\(X,{NUMBER},Y,{NUMBER},Z,{NUMBER}\) : CROT\(X,{NUMBER},Y,{NUMBER},"
        rf"Z,{NUMBER}\)",
        "heidenhain": rf"X {NUMBER} Y {NUMBER} Z {NUMBER} SPA {NUMBER} SPB {NUMBER} SPC {NUMBER}",
        "fanuc": rf"G10 L\S+ P\d+ X{NUMBER} Y{NUMBER} Z{NUMBER}\n[^\n]*\nG68.2 X0. Y0. Z0."
        rf" I{NUMBER} J{NUMBER} K{NUMBER}",
        "fagor": rf"X = {NUMBER}\n.*Y = {NUMBER}\n.*Z = {NUMBER}\n.*\n.*MODE 1, 0, 0, 0, {NUMBER},"
        rf" {NUMBER}, {NUMBER}\]",
    }
    found = re.search(patterns[control], said)
    assert found is not None, said
    values = [float(value) for value in found.groups()]
    return values[:3], values[3:]


def _where(control: str, text: str, point: np.ndarray) -> np.ndarray:
    offset, turns = _numbers(control, text)
    for axis, place in ORDER[control]:
        point = _turned(point, axis, turns[place])
    return point + offset


@pytest.mark.parametrize("pose", ["A", "B"])
@pytest.mark.parametrize("control", ["siemens", "heidenhain", "fanuc", "fagor"])
def test_words_turned_back_are_the_pose(control: str, pose: str) -> None:
    machine_T_part, point, expected = POINTS[pose]
    handed = hand_over(machine_T_part, control, box=BOX_A if pose == "A" else BOX_B)
    back = _where(control, handed.text, np.array(point, dtype=float))
    # Four decimals of a degree are 1 µm at 1 m.
    assert np.linalg.norm(back - expected) < (0.003 if control == "heidenhain" else 0.0005)


@pytest.mark.parametrize("control", ["siemens", "heidenhain", "fanuc", "fagor"])
def test_told_error_is_the_error_of_the_words(control: str) -> None:
    handed = hand_over(B, control, box=BOX_B)
    misses = [np.linalg.norm(_where(control, handed.text, p) - B @ p) for p in BOX_B.corners_mm()]
    assert handed.error_mm == pytest.approx(max(misses), abs=1e-9)


@pytest.mark.parametrize(
    ("formula", "a", "b"),
    [
        (angles.rpy_deg, (10, 20, 30), (0.114591559, -0.171887339, 0.229183118)),
        (
            angles.zxz_deg,
            (92.726830443, 22.268744495, -64.494449739),
            (-56.080674431, 0.206582776, 56.310029436),
        ),
        (
            angles.xyz_turned_deg,
            (-1.116054677, 22.242180910, 28.451775257),
            (0.115278705, -0.171427253, 0.229527461),
        ),
    ],
)
def test_angles_of_the_worked_poses(formula, a, b) -> None:  # type: ignore[no-untyped-def]
    np.testing.assert_allclose(formula(A.rotation), a, atol=2e-9)
    np.testing.assert_allclose(formula(B.rotation), b, atol=2e-9)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.7), (np.pi, 0.0, 0.7)])
def test_zxz_without_tilt_is_one_turn(turn: tuple[float, float, float]) -> None:
    rotation = RigidTransform.from_euler_xyz_rad(*turn).rotation
    np.testing.assert_allclose(
        angles.rotation_of_zxz(angles.zxz_deg(rotation)), rotation, atol=1e-12
    )


def test_crot_reads_back_as_the_control_reads_it() -> None:
    given = angles.rotation_of_rpy((190.0, 0.0, -200.0))
    np.testing.assert_allclose(angles.rpy_deg(given), (-170.0, 0.0, 160.0), atol=1e-9)


def test_linuxcnc_is_right_in_the_middle_and_tells_the_tilt() -> None:
    handed = hand_over(B, "linuxcnc", box=BOX_B, remaining_mm=5.0)
    offset, (turn,) = _numbers("linuxcnc", handed.text)
    assert turn == pytest.approx(0.229355005577, abs=1e-8)
    np.testing.assert_allclose(offset, [812.340138, -410.253269, 158.269991], atol=1e-6)
    middle = np.array([750.0, 500.0, 0.0])
    np.testing.assert_allclose(_where("linuxcnc", handed.text, middle), B @ middle, atol=2e-6)
    assert "2.011983 about X, -2.991966 about Y" in handed.text
    for height in ("-3.25", "-1.25", "+1.25", "+3.25"):
        assert height in handed.text


def test_linuxcnc_refuses_a_tilt_that_moves_a_corner() -> None:
    with pytest.raises(MeasurementError, match="Nothing is written"):
        hand_over(A, "linuxcnc", box=BOX_A)


def test_siemens_refuses_a_turn_that_has_two_descriptions() -> None:
    upright = RigidTransform.from_euler_xyz_rad(0.1, np.pi / 2.0, 0.2)
    with pytest.raises(MeasurementError, match="less than 90"):
        hand_over(upright, "siemens")


def test_siemens_writes_only_where_the_control_turns_as_assumed() -> None:
    lines = hand_over(B, "siemens", offset="G505").text.splitlines()
    frame = next(i for i, line in enumerate(lines) if "$P_UIFR[5]" in line)
    assert "ELSE" in lines[:frame]
    assert "IF $MN_FRAME_ANGLE_INPUT_MODE <> 1" in lines[:frame]


@pytest.mark.parametrize(
    ("control", "offset"),
    [
        ("linuxcnc", "G60"),
        ("linuxcnc", "G59.4"),
        ("siemens", "G58"),
        ("siemens", "G504"),
        ("siemens", "G600"),
        ("heidenhain", "G54"),
        ("heidenhain", "-1"),
        ("fanuc", "G54.1"),
        ("fanuc", "G54.1 P0"),
        ("fagor", "G60"),
        ("fagor", "G54\nM3"),
        ("mazak", "G54"),
    ],
)
def test_offsets_that_there_are_not_are_refused(control: str, offset: str) -> None:
    with pytest.raises(InputError):
        hand_over(RigidTransform.identity(), control, offset=offset)


@pytest.mark.parametrize("control", CONTROLS)
def test_assumed_box_is_said_and_comments_are_ascii(control: str) -> None:
    text = hand_over(RigidTransform.identity(), control, title="a(b)\nM3 ö").text
    assert "ASSUMED 0 TO 1000 MM" in text.upper()
    assert "CONFIRM" in text
    assert text.isascii()
    assert not any(line.startswith("M3 ") for line in text.splitlines())


_QUARTER = math.pi / 2.0
_ANGLE = st.floats(-math.pi, math.pi) | st.sampled_from(
    [0.0, _QUARTER, -_QUARTER, _QUARTER - 1e-9, math.pi, -math.pi, 1e-7]
)


@given(st.tuples(_ANGLE, _ANGLE, _ANGLE), st.tuples(*[st.floats(-20_000.0, 20_000.0)] * 3))
@settings(max_examples=40, deadline=None)
def test_every_pose_is_said_or_refused_and_the_told_error_holds(
    euler: tuple[float, float, float], xyz: tuple[float, float, float]
) -> None:
    """Half turns and gimbal lock included; G54.4's numbers in Fanuc's comment as well."""
    pose = RigidTransform.from_euler_xyz_rad(*euler, xyz)
    box = Box(
        low_mm=np.array([-5e3, -1.5e3, 0.0]), high_mm=np.array([5e3, 1.5e3, 2.5e3]), source=""
    )
    for control in ("siemens", "heidenhain", "fanuc", "fagor"):
        try:
            made = hand_over(pose, control, box=box, remaining_mm=1.0)
        except MeasurementError:
            assert control == "siemens"
            assert abs(math.degrees(math.asin(np.clip(-pose.rotation[2, 0], -1, 1)))) > 89.99
            continue
        misses = [_where(control, made.text, p) - pose @ p for p in box.corners_mm()]
        assert np.linalg.norm(misses, axis=1).max() == pytest.approx(made.error_mm, abs=1e-6)
        if control == "fanuc":
            numbers = [float(v) for v in re.findall(r"#2601\d=(-?[\d.]+)", made.text)]
            for point in box.corners_mm():
                turned = point
                for axis, at in ((2, 5), (1, 4), (0, 3)):
                    turned = _turned(turned, axis, numbers[at])
                assert np.linalg.norm(turned + numbers[:3] - pose @ point) < 0.01
