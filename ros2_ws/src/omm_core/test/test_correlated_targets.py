"""A survey's correlations reach the pose: part.yaml's covariance_mm2 against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import EXACT_MACHINE, bench_cell
from scipy.spatial.transform import Rotation

from omm_core.files.part import load_part, part_yaml
from omm_core.geometry import RigidTransform
from omm_core.part_pose import SolveOptions, solve

SHIFT_MM, TURN_RAD = 0.05, 4e-5
DATUM = np.diag(np.r_[np.full(3, TURN_RAD), np.full(3, SHIFT_MM)] ** 2)
"""Of the survey's frame against the part: turns (rad) and shifts (mm) that all targets share."""


@pytest.fixture(scope="module")
def cell():
    return bench_cell(np.random.default_rng(11))


def shared_motion(part):
    """Return d(coordinates of all targets) / d(turn, shift), (3T, 6)."""
    cross = [np.cross(np.eye(3), target.xyz_mm).T for target in part.targets]
    return np.vstack([np.column_stack([c, np.eye(3)]) for c in cross])


def solved(cell, folder, part):
    """Return the solution with the part as its file holds it."""
    (folder / "part.yaml").write_text(part_yaml(part))
    observations = cell.noisy(np.random.default_rng(12), 0.02)
    read = load_part(folder / "part.yaml")
    return solve(observations, read, cell.calibration, SolveOptions(**EXACT_MACHINE))


def with_covariance(part, covariance):
    sigma = np.sqrt(np.diag(covariance)).reshape(-1, 3)
    targets = tuple(replace(t, sigma_xyz_mm=s) for t, s in zip(part.targets, sigma, strict=True))
    return replace(part, targets=targets, covariance_mm2=covariance)


def pose_of_motion(pose):
    """Return d(alpha, beta, gamma, x, y, z) / d(turn, shift), (6, 6), by differences.

    Coordinates moved by M in the part frame are met by the pose machine_T_part @ M⁻¹.
    """
    columns = []
    for step in 1e-5 * np.eye(6):
        ends = []
        for sign in (1.0, -1.0):
            turn = Rotation.from_rotvec(sign * step[:3]).as_matrix()
            moved = RigidTransform(rotation=turn, translation_mm=sign * step[3:])
            found = pose @ moved.inverse()
            ends.append(np.r_[found.euler_xyz_rad(), found.translation_mm])
        columns.append((ends[0] - ends[1]) / 2e-5)
    return np.column_stack(columns)


def test_what_all_targets_share_goes_into_the_pose_as_one_motion(cell, tmp_path):
    exact = solved(cell, tmp_path, cell.part).covariance
    motion = shared_motion(cell.part)
    part = with_covariance(cell.part, motion @ DATUM @ motion.T)
    added = solved(cell, tmp_path, part).covariance - exact
    wanted = np.zeros((7, 7))
    to_pose = pose_of_motion(cell.machine_T_part)
    wanted[:6, :6] = to_pose @ DATUM @ to_pose.T  # the spindle's angle does not see it
    size = np.sqrt(np.diag(wanted[:6, :6]))
    scale = np.outer(np.r_[size, 1e-5], np.r_[size, 1e-5])
    assert np.abs((added - wanted) / scale).max() < 0.01


def test_single_sigmas_alone_say_something_else(cell, tmp_path):
    """Four targets that err together in z are as uncertain as one; apart, their mean is half."""
    exact = solved(cell, tmp_path, cell.part).covariance
    together = np.kron(np.ones((4, 4)), SHIFT_MM**2 * np.eye(3))
    centre = np.mean([t.xyz_mm for t in cell.part.targets], axis=0)
    height = {}
    for name, covariance in (("together", together), ("apart", np.diag(np.diag(together)))):
        part = with_covariance(cell.part, covariance)
        added = solved(cell, tmp_path, part).covariance - exact
        lever = height_of(centre, cell.machine_T_part)
        height[name] = np.sqrt(lever @ added[:6, :6] @ lever)
    assert height["together"] == pytest.approx(SHIFT_MM, rel=0.01)
    assert height["apart"] == pytest.approx(SHIFT_MM / 2.0, rel=0.05)


def height_of(point, pose):
    """Return d(machine z of a part's point) / d(pose), (6,), by differences."""
    values = np.r_[pose.euler_xyz_rad(), pose.translation_mm]

    def z(at):
        return (RigidTransform.from_euler_xyz_rad(*at[:3], translation_mm=at[3:]) @ point)[2]

    return np.array([(z(values + s) - z(values - s)) / 2e-6 for s in 1e-6 * np.eye(6)])
