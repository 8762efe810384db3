"""Markers show what was measured, where it is, and take it away when it holds no longer."""

import numpy as np
import pytest

pytest.importorskip("visualization_msgs", reason="ROS 2 is not there")

from visualization_msgs.msg import Marker

from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform
from omm_operator.scene import part_markers, place_covariance_mm2
from omm_operator.screen.facts import EstimateFact

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
