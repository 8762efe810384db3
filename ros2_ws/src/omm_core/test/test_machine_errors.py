"""Errors of simulated machines follow their statistics, and own truth its definition."""

import numpy as np
import pytest
from core_cells import PAPER_CALIBRATION
from known_noise import KnownNoise, solve_knowing_all
from reference_model import predict

from omm_core.errors import InputError
from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.machine_errors import (
    GeometryField,
    approach_signs,
    draw_calibration,
    draw_geometry,
    draw_stop_noise,
    draw_targets,
    geometry_covariance,
    lost_motion,
    own_pose,
    spindle_drift,
    thermally_expanded,
)

PLACES = np.array([[0, 0, 0], [300, 0, 50], [1500, 0, 0], [1500, 1000, 10], [0, 1000, 300.0]])
SIGMA, LENGTH = 0.015, 700.0
TARGETS = np.array([[0, 0, 4], [1500, 0, 12], [1500, 1000, 8], [0, 1000, -8.0]])
POSE = RigidTransform.from_euler_xyz_rad(2e-3, -1e-3, 3e-3, (85.0, 288.0, -254.0))
SEEN = np.repeat(np.arange(4), 2)


def assert_covariance(drawn, expected):
    """Sample covariances of (R, S) draws lie within five of their own standard deviations."""
    sample = drawn.T @ drawn / len(drawn)
    variances = np.diag(expected)
    deviation = np.sqrt((expected**2 + np.outer(variances, variances)) / len(drawn))
    assert np.all(np.abs(sample - expected) < 5 * deviation)


def test_geometry_drawn_at_places_has_the_covariance_it_is_drawn_from():
    random = np.random.default_rng(1)
    drawn = np.array([draw_geometry(random, PLACES, SIGMA, LENGTH) for _ in range(3000)])
    for axis in range(3):
        assert_covariance(drawn[:, :, axis], geometry_covariance(PLACES, SIGMA, LENGTH))
    across = np.mean(drawn[:, :, 0] * drawn[:, :, 1], axis=0)
    assert np.all(np.abs(across) < 5 * SIGMA**2 / np.sqrt(3000))


def test_machines_drawn_as_fields_have_the_same_covariance():
    random = np.random.default_rng(2)
    machines = np.array([GeometryField.draw(random, SIGMA, LENGTH)(PLACES) for _ in range(1500)])
    for axis in range(3):
        assert_covariance(machines[:, :, axis], geometry_covariance(PLACES, SIGMA, LENGTH))


def test_a_field_is_the_same_wherever_it_is_asked_from():
    machine = GeometryField.draw(np.random.default_rng(3), SIGMA, LENGTH)
    np.testing.assert_allclose(machine(PLACES)[3], machine(PLACES[3:4])[0], atol=1e-15)
    again = GeometryField.draw(np.random.default_rng(3), SIGMA, LENGTH)
    np.testing.assert_array_equal(machine(PLACES), again(PLACES))


def test_a_field_varies_smoothly():
    """Over a hundredth of its length it changes by about a hundredth of its σ, on each axis."""
    random = np.random.default_rng(4)
    steps = np.array([
        field(PLACES + [LENGTH / 100, 0, 0]) - field(PLACES)
        for field in (GeometryField.draw(random, SIGMA, LENGTH) for _ in range(200))
    ])  # fmt: skip
    assert np.sqrt(np.mean(steps**2)) == pytest.approx(SIGMA / 100, rel=0.1)


def test_stops_repeat_to_their_sigma():
    noise = draw_stop_noise(np.random.default_rng(5), 20_000, 0.003)
    assert_covariance(noise, 0.003**2 * np.eye(3))


def test_without_errors_of_the_geometry_own_is_absolute():
    own = own_pose(POSE, TARGETS, SEEN, np.zeros((8, 3)))
    np.testing.assert_allclose(own.rotation, POSE.rotation, atol=1e-14)
    np.testing.assert_allclose(own.translation_mm, POSE.translation_mm, atol=1e-9)


def test_a_rigid_error_of_the_geometry_is_wholly_absorbed():
    """The machine would go to P - e: where P - e is a rigid motion of P, that is the own pose."""
    motion = RigidTransform.from_euler_xyz_rad(4e-5, -3e-5, 6e-5, (0.02, -0.03, 0.01))
    P = POSE @ TARGETS
    own = own_pose(POSE, TARGETS, SEEN, (P - motion @ P)[SEEN])
    expected = motion @ POSE
    np.testing.assert_allclose(own.rotation, expected.rotation, atol=1e-12)
    np.testing.assert_allclose(own.translation_mm, expected.translation_mm, atol=1e-9)


def test_a_target_counts_once_however_often_it_is_seen():
    errors = draw_geometry(np.random.default_rng(6), (POSE @ TARGETS)[SEEN], SIGMA, LENGTH)
    errors[:2] = errors[:2].mean(axis=0)
    often = own_pose(
        POSE, TARGETS, [0] * 7 + list(SEEN), np.concatenate([errors[:1].repeat(7, axis=0), errors])
    )
    once = own_pose(POSE, TARGETS, SEEN, errors)
    np.testing.assert_allclose(often.translation_mm, once.translation_mm, atol=1e-9)


def test_what_is_left_of_the_errors_at_the_targets_is_no_rigid_motion():
    P, random = POSE @ TARGETS, np.random.default_rng(7)
    errors = draw_geometry(random, P, SIGMA, LENGTH)
    own = own_pose(POSE, TARGETS, np.arange(4), errors)
    left = own @ TARGETS - (P - errors)
    np.testing.assert_allclose(left.sum(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.cross(own @ TARGETS, left).sum(axis=0), 0.0, atol=1e-8)
    assert np.linalg.norm(left) > 0.1 * SIGMA


def test_targets_on_a_line_have_no_own_pose():
    with pytest.raises(InputError, match="3 targets that do not lie on a line"):
        own_pose(POSE, np.outer([0.0, 1.0, 5.0], [3.0, 2.0, 1.0]), [0, 1, 2], np.zeros((3, 3)))
    with pytest.raises(InputError, match="got 2 targets"):
        own_pose(POSE, TARGETS, [0, 1], np.zeros((2, 3)))


def known(geometry_mm, noise):
    """Return what a solver that knows all makes of stops that are off by ``geometry_mm``."""
    spindles = [
        RigidTransform(rotation=np.eye(3), translation_mm=POSE @ TARGETS[t] + [30.0 * side, 0, 470])
        for t in range(4)
        for side in (-1, 1)
    ]
    theta = np.array([*POSE.euler_xyz_rad(), *POSE.translation_mm, 1e-3])
    true = [
        RigidTransform(rotation=np.eye(3), translation_mm=s.translation_mm + e)
        for s, e in zip(spindles, geometry_mm)
    ]
    pixels = [
        predict(PAPER_CALIBRATION.lens, theta, TARGETS[t], s, PAPER_CALIBRATION.taper_T_camera)[0]
        for s, t in zip(true, SEEN)
    ]
    return theta, solve_knowing_all(
        theta, TARGETS, np.arange(8), SEEN, spindles, PAPER_CALIBRATION, pixels, noise
    )


def test_what_a_solver_that_knows_all_calls_own_is_what_own_pose_says():
    """With geometry much larger than all else it sees its errors, but for what is rigid."""
    places = (POSE @ TARGETS)[SEEN]
    errors = draw_geometry(np.random.default_rng(8), places, SIGMA, LENGTH)
    errors[1::2] = errors[::2]  # the same at both stops of a target: the images see it all
    noise = KnownNoise(
        image_sigma_px=1e-4, stop_sigma_mm=0.0, geometry=geometry_covariance(places, 0.1, LENGTH)
    )
    theta, found = known(errors, noise)
    own = own_pose(POSE, TARGETS, SEEN, errors)
    expected = np.array([*own.euler_xyz_rad(), *own.translation_mm, 1e-3])
    scale = np.sqrt(np.diag(found.own_covariance))
    assert np.all(np.abs(found.own - expected) < 4 * scale)
    assert np.all(scale[3:5] < 1e-3)
    assert np.any(np.abs(expected - theta)[3:6] > 5 * scale[3:6])


def test_lost_motion_is_the_difference_between_coming_from_either_side():
    path = np.array([[0, 0, 0], [5, -5, 0], [5, -4, 0], [4, -4, 1.0]])
    signs = approach_signs(path)
    np.testing.assert_array_equal(signs[1:], [[1, -1, 0], [1, 1, 0], [-1, 1, 1]])
    width = np.array([0.004, 0.006, 0.002])
    plus, minus = lost_motion([1, 1, 1], width), lost_motion([-1, -1, -1], width)
    np.testing.assert_allclose(minus - plus, width)
    np.testing.assert_array_equal(lost_motion(signs[0], width), 0.0)


def test_a_drift_begins_at_nothing_and_ends_where_it_is_told():
    final = np.array([0.0, 0.002, 0.01])
    drift = spindle_drift([-5.0, 0.0, 600.0, 1e9], final, 600.0)
    np.testing.assert_array_equal(drift[:2], 0.0)
    np.testing.assert_allclose(drift[2], final * (1 - np.exp(-1)))
    np.testing.assert_allclose(drift[3], final)


def test_steel_of_a_metre_grows_by_11_micrometres_a_kelvin():
    grown = thermally_expanded([[1000.0, 0.0, 0.0]], 1.0, 11e-6)
    np.testing.assert_allclose(grown, [[1000.011, 0.0, 0.0]], atol=1e-12)


def test_targets_are_drawn_by_what_is_declared_and_stay_where_nothing_is():
    declared = Target(id=1, xyz_mm=np.zeros(3), dot_diameter_mm=8.0,
                      sigma_xyz_mm=np.array([0.01, 0.02, 0.0]))  # fmt: skip
    exact = Target(id=2, xyz_mm=np.ones(3), dot_diameter_mm=8.0)
    part = Part(name="p", target_family="aicon12", targets=(declared, exact))
    random = np.random.default_rng(9)
    drawn = [draw_targets(random, part).targets for _ in range(4000)]
    assert_covariance(np.array([d[0].xyz_mm for d in drawn])[:, :2], np.diag([1e-4, 4e-4]))
    assert all(d[0].xyz_mm[2] == 0.0 for d in drawn)
    np.testing.assert_array_equal([d[1].xyz_mm for d in drawn], 1.0)


def test_cameras_are_drawn_by_the_covariance_of_their_calibration():
    names = ("focal_length_mm", "cl0_px", "z_mm", "alpha_rad")
    sigma = np.array([0.002, 0.3, 0.05, 2e-5])
    correlation = np.array([[1, 0, -0.9, 0], [0, 1, 0, 0.5], [-0.9, 0, 1, 0], [0, 0.5, 0, 1]])
    calibration = CameraCalibration(
        name="c", lens=PAPER_CALIBRATION.lens, taper_T_camera=PAPER_CALIBRATION.taper_T_camera,
        parameters=names, covariance=correlation * np.outer(sigma, sigma),
    )  # fmt: skip
    random = np.random.default_rng(10)
    drawn = [draw_calibration(random, calibration).parameter_values(names) for _ in range(3000)]
    errors = (np.array(drawn) - calibration.parameter_values(names)) / sigma
    assert_covariance(errors, correlation)
    assert draw_calibration(random, PAPER_CALIBRATION) is PAPER_CALIBRATION
