"""Markers show what was measured, where it is, and take it away when it holds no longer."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("visualization_msgs", reason="ROS 2 is not there")

from ament_index_python.packages import get_package_share_directory
from builtin_interfaces.msg import Time
from visualization_msgs.msg import Marker

from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform
from omm_core.machine.kinematics import Kinematics
from omm_core.machine.urdf import load_urdf
from omm_operator.scene import link_frames, part_markers, place_covariance_mm2
from omm_operator.screen.facts import EstimateFact
from omm_ros import topics

THETA = np.array([0.02, -0.03, 0.5, 100.0, 200.0, 50.0, 0.0])
FRAMES = {"part_frame": "part", "machine_frame": "machine"}


def part() -> Part:
    corners = ((0.0, 0.0, 0.0), (300.0, 0.0, 0.0), (0.0, 200.0, 10.0))
    targets = tuple(
        Target(id=k, xyz_mm=np.array(xyz), dot_diameter_mm=5.0)
        for k, xyz in enumerate(corners, start=1)
    )
    return Part(name="plate", target_family="aicon12", targets=targets)


def estimate(**more: object) -> EstimateFact:
    root = np.random.default_rng(1).normal(size=(7, 7)) * np.array([1e-5] * 3 + [1e-2] * 3 + [1e-5])
    values = {
        "part": "plate", "determined": True, "converged": True, "theta": THETA,
        "covariance": root.T @ root, "expanded_uncertainty": np.ones(7),
        "targets": ((1, 2), (2, 1), (3, 0)),
    }  # fmt: skip
    return EstimateFact(**(values | more))


def test_the_covariance_of_a_place_is_that_of_many_drawn_poses() -> None:
    fact, point = estimate(), np.array([300.0, 200.0, 10.0])
    drawn = np.random.default_rng(2).multivariate_normal(THETA, fact.covariance, 20_000)
    places = np.array(
        [RigidTransform.from_euler_xyz_rad(*t[:3], translation_mm=t[3:6]) @ point for t in drawn]
    )
    expected = np.cov(places.T)
    found = place_covariance_mm2(fact, point)
    assert np.allclose(found, expected, atol=0.03 * np.abs(expected).max())


def test_targets_are_coloured_by_how_often_they_were_seen() -> None:
    markers = part_markers(estimate(), part(), enlargement=1000.0, **FRAMES).markers
    dots = [m for m in markers if m.ns == "targets"]
    assert len({(m.color.r, m.color.g, m.color.b) for m in dots}) == 3
    assert [m.text for m in markers if m.ns == "target numbers"] == ["1", "2", "3"]
    assert dots[1].pose.position.x == pytest.approx(0.3)


def test_ellipsoids_are_twice_two_sigma_long_enlarged_and_turned_rightly() -> None:
    fact = estimate()
    markers = part_markers(fact, part(), enlargement=1000.0, **FRAMES).markers
    doubts = [m for m in markers if m.ns == "uncertainty"]
    assert len(doubts) == 8
    one = doubts[-1]
    o = one.pose.orientation
    axes = RigidTransform.from_quaternion_xyzw((o.x, o.y, o.z, o.w), np.zeros(3)).rotation
    sigma_mm = np.array([one.scale.x, one.scale.y, one.scale.z]) * 1e3 / 1000.0 / 4.0
    covariance = axes @ np.diag(sigma_mm**2) @ axes.T
    assert np.allclose(covariance, place_covariance_mm2(fact, part().box_corners()[-1]), rtol=1e-4)


def test_a_pose_that_holds_no_longer_takes_its_markers_away() -> None:
    markers = part_markers(estimate(revoked=True), part(), enlargement=1.0, **FRAMES).markers
    assert [m.action for m in markers] == [Marker.DELETEALL]


MACHINES = Path(get_package_share_directory("omm_cnc_bridge")) / "machines"


@pytest.mark.parametrize("name", ["three_axis_mill", "gantry_bc_head", "table_table"])
def test_frames_of_the_links_end_in_the_pose_that_the_bridge_tells(name: str) -> None:
    """The links' frames are computed as the bridge's kinematics do it: shown for the tip itself."""
    path = MACHINES / f"{name}.urdf"
    machine, robot = Kinematics.load(path), load_urdf(path)
    si = {a.name: 0.3 if a.rotary else 0.2 for a in machine.axes}
    core = {a.name: si[a.name] * (1.0 if a.rotary else 1000.0) for a in machine.axes}
    frames = {f.child_frame_id: f for f in link_frames(robot, si, Time(), tip="")}
    assert set(frames) == set(robot.links) - {robot.root}
    assert all(f.header.frame_id == robot.root for f in frames.values())
    told = {f.child_frame_id for f in link_frames(robot, si, Time(), tip="spindle")}
    assert "spindle" not in told
    if name != "table_table":  # there, the pose is told in the part's table
        at = frames["spindle"].transform.translation
        expected = machine.machine_T_spindle(core).translation_mm / 1000.0
        assert np.allclose([at.x, at.y, at.z], expected, atol=1e-12)


def test_a_link_on_an_axis_that_is_not_told_is_left_out() -> None:
    robot = load_urdf(MACHINES / "three_axis_mill.urdf")
    frames = link_frames(robot, {"X": 0.1}, Time(), tip="")
    assert [f.child_frame_id for f in frames] == ["bridge"]


def _layouts() -> tuple[Path, Path]:
    folder = Path(get_package_share_directory("omm_operator")) / "layouts"
    return folder / "omm.rviz", folder / "omm.foxglove.json"


def _named_topics() -> set[str]:
    return {
        name for path in _layouts()
        for name in re.findall(r"[\"\s{](/[a-z_]+(?:/[a-z_]+)*)", path.read_text())
    }  # fmt: skip


def test_layouts_name_only_topics_and_displays_that_there_are() -> None:
    known = {v if v.startswith("/") else f"/{v}" for v in vars(topics).values()
             if isinstance(v, str) and re.fullmatch(r"/?[a-z_]+(/[a-z_]+)*", v)}  # fmt: skip
    assert _named_topics() <= known
    assert {"/omm/markers", "/omm/camera_view", "/robot_description"} <= _named_topics()
    rviz, foxglove = _layouts()
    displays = yaml.safe_load(rviz.read_text())["Visualization Manager"]["Displays"]
    classes = {d["Class"].removeprefix("rviz_default_plugins/") for d in displays}
    assert classes == {"Grid", "TF", "RobotModel", "MarkerArray", "Image"}
    layout = json.loads(foxglove.read_text())
    kinds = {name.partition("!")[0] for name in layout["configById"]}
    assert kinds == {"3D", "Image", "RawMessages", "DiagnosticSummary"}
    shown = set(re.findall(r'"(\w+![a-z]+)"', json.dumps(layout["layout"])))
    assert shown == set(layout["configById"])
