"""Probed points are judged by the covariance that they have together."""

from pathlib import Path

import numpy as np
import pytest

from omm_core.budget.probing import check_probing
from omm_core.errors import InputError
from omm_core.files.probe_log import with_log
from omm_core.files.probed import ProbedPoint, load_probed, probed_csv
from omm_core.geometry import RigidTransform

THETA = np.array([0.002, -0.3, 0.5, 100.0, 200.0, 50.0])
CORNERS = np.array([[x, y, z] for x in (0, 1500) for y in (0, 1000) for z in (0, 500)], dtype=float)
HEAD = "name,part_x_mm,part_y_mm,part_z_mm,x_mm,y_mm,z_mm,sigma_mm\n"


def pose(theta):  # type: ignore[no-untyped-def]
    return RigidTransform.from_euler_xyz_rad(*theta[:3], translation_mm=theta[3:6])


def covariance(random):  # type: ignore[no-untyped-def]
    root = random.normal(size=(6, 6)) * np.array([[5e-6] * 3 + [0.005] * 3]).T
    return root @ root.T


def touches(random, sigma=0.003, cov=None, more=0.0):  # type: ignore[no-untyped-def]
    cov = covariance(random) if cov is None else cov
    true = THETA + random.multivariate_normal(np.zeros(6), cov)
    found = pose(true) @ CORNERS + random.normal(0, sigma, CORNERS.shape) + more
    points = [
        ProbedPoint(name=f"P{i}", part_mm=p, machine_mm=m, sigma_mm=sigma)
        for i, (p, m) in enumerate(zip(CORNERS, found))
    ]
    return points, cov


def test_errors_of_a_true_pose_and_probe_are_believed_and_inside_u() -> None:
    random = np.random.default_rng(1)
    shares, p_values = [], []
    for _ in range(400):
        points, cov = touches(random)
        check = check_probing(points, THETA, cov)
        shares.append(check.share_inside)
        p_values.append(check.p_value)
    assert np.mean(shares) == pytest.approx(0.9545, abs=0.02)
    assert np.mean(np.array(p_values) < 0.1) == pytest.approx(0.1, abs=0.05)


def test_a_part_that_moved_is_found_as_one_motion() -> None:
    random = np.random.default_rng(2)
    points, cov = touches(random, more=np.array([0.2, -0.1, 0.05]))
    check = check_probing(points, THETA, cov)
    assert check.believed is False
    assert check.motion is not None
    assert check.motion[3:] == pytest.approx([0.2, -0.1, 0.05], abs=0.03)
    assert check.left_mm is not None
    assert np.all(check.left_mm < 0.006)


def test_one_point_that_is_off_is_the_one_outside() -> None:
    points, cov = touches(np.random.default_rng(3))
    bad = points[5]
    points[5] = ProbedPoint(
        name="bad", part_mm=bad.part_mm, machine_mm=bad.machine_mm + [0.3, 0, 0], sigma_mm=0.003
    )
    check = check_probing(points, THETA, cov)
    assert not check.inside[5, 0]
    assert check.believed is False


def test_without_the_probes_sigma_nothing_is_claimed_of_all_together() -> None:
    points, cov = touches(np.random.default_rng(4))
    untold = [ProbedPoint(name=p.name, part_mm=p.part_mm, machine_mm=p.machine_mm) for p in points]
    check = check_probing(untold, THETA, cov)
    assert check.believed is None
    assert any("sigma_mm" in words for words in check.findings)


def test_points_on_a_line_tell_no_motion() -> None:
    points, cov = touches(np.random.default_rng(5))
    assert check_probing(points[:2], THETA, cov).motion is None


def test_the_file_comes_back_as_it_was(tmp_path: Path) -> None:
    points, _ = touches(np.random.default_rng(6))
    path = tmp_path / "points.csv"
    path.write_text(probed_csv(tuple(points)))
    for one, other in zip(points, load_probed(path)):
        assert one.name == other.name
        assert np.array_equal(one.part_mm, other.part_mm)
        assert other.machine_mm is not None
        assert np.array_equal(one.machine_mm, other.machine_mm)  # type: ignore[arg-type]


def test_linuxcncs_probe_log_fills_the_points_in_order(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("name,part_x_mm,part_y_mm,part_z_mm\nA,0,0,0\nB,10,0,0\n")
    (tmp_path / "probe.log").write_text(
        "1.5 2.5 -3.25 0.0 0.0 0.0 0.0 0.0 0.0\n4 5 6 0 0 0 0 0 0\n\n"
    )
    points = with_log(load_probed(tmp_path / "points.csv", probed=False), tmp_path / "probe.log")
    assert points[0].machine_mm == pytest.approx([1.5, 2.5, -3.25])
    assert points[1].machine_mm == pytest.approx([4, 5, 6])
    (tmp_path / "probe.log").write_text("1 2 3 0 0 0 0 0 0\n")
    with pytest.raises(InputError, match="2 points"):
        with_log(points, tmp_path / "probe.log")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "expected"),
        (HEAD, "line for each touch"),
        ("name,part_x_mm\nA,1\n", "part_y_mm"),
        (HEAD + "A,0,0,0,1,2\n", "number for z_mm"),
        (HEAD + "A,0,0,0,1,2,nan,0.1\n", "number for z_mm"),
        (HEAD + "A,0,0,0,1,2,3,-0.1\n", "sigma_mm >= 0"),
        (HEAD + ",0,0,0,1,2,3,0.1\n", "name"),
    ],
)
def test_a_file_of_points_that_is_none_is_refused(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "points.csv").write_text(text)
    with pytest.raises(InputError, match=told):
        load_probed(tmp_path / "points.csv")


def test_points_in_other_coordinates_are_doubted() -> None:
    places = np.array([[0.0, 0, 0], [500.0, 0, 0], [0, 500.0, 0]])
    for off, told in ((0.5, 0), (250.0, 1)):
        points = [
            ProbedPoint(name=f"P{i}", part_mm=p, machine_mm=p + (0, 0, off), sigma_mm=0.01)
            for i, p in enumerate(places)
        ]
        check = check_probing(points, [0.0] * 6, np.eye(6) * 1e-6)
        assert len([w for w in check.findings if "machine coordinates" in w]) == told
