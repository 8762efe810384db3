"""The compiled kernels against the plain model, and analytic against numeric derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from core_cameras import LENS_NAMES, LENSES
from core_cells import PAPER_CALIBRATION, random_cell
from reference_model import predict

from omm_core.geometry import RigidTransform, spindle_T_taper
from omm_core.imaging.circle import CircleCentre, project_circles
from omm_core.imaging.kernels import lens_pixel
from omm_core.part_pose import SolveOptions, build_problem
from omm_core.part_pose.adjustment import Adjustment, predictions, refine
from omm_core.part_pose.kernels import normal_equations, predict_all, rotate, workspace
from omm_core.part_pose.model import Normal, State
from omm_core.part_pose.start import Start

both = pytest.mark.parametrize("lens", LENSES, ids=LENS_NAMES)


def problem_and_truth(lens, seed=3, kind=CircleCentre.OUTLINE):
    calibration = replace(PAPER_CALIBRATION, lens=lens)
    cell = random_cell(np.random.default_rng(seed), calibration)
    problem = build_problem(cell.observations, cell.part, calibration, kind)
    truth = Adjustment(
        rotation=cell.machine_T_part.rotation.copy(),
        d0_mm=cell.machine_T_part @ problem.X0_mm,
        gamma_s_rad=cell.gamma_s_rad,
        cost=0.0, normal=np.zeros((7, 7)), converged=True, iterations=0,
    )  # fmt: skip
    return cell, problem, truth


@both
def test_the_compiled_lens_is_the_lens(lens):
    normalised = lens.rays(lens.pixel_grid(9))[:, :2]
    pixels, jacobians = lens.pixels_from_normalised(normalised)
    for (x, y), pixel, jacobian in zip(normalised, pixels, jacobians):
        values = lens_pixel(lens.kernel_parameters(), x, y)
        assert np.allclose(values[:2], pixel, atol=1e-9)
        assert np.allclose(values[2:], jacobian.ravel(), rtol=1e-9, atol=1e-6)
    assert np.isnan(lens_pixel(lens.kernel_parameters(), 100.0, 0.0)[0])


@both
def test_points_and_their_derivative_by_theta_are_those_of_the_paper(lens):
    cell, problem, truth = problem_and_truth(lens)
    problem = replace(problem, circles=problem.points)
    pixels, local = predictions(problem, truth)
    by_theta = local @ np.linalg.inv(truth.d_theta_d_local(problem.X0_mm))
    for n, observation in enumerate(problem.observations):
        X = cell.part.target(observation.target_id).xyz_mm
        pixel, jacobian = predict(
            lens, cell.theta, X, observation.machine_T_spindle, problem.calibration.taper_T_camera
        )
        assert np.allclose(pixels[n], pixel, atol=1e-8)
        assert np.allclose(by_theta[n], jacobian, rtol=1e-6, atol=1e-6 * np.abs(jacobian).max())


@both
@pytest.mark.parametrize("kind", list(CircleCentre))
def test_circles_are_those_of_the_plain_model(lens, kind):
    cell, problem, truth = problem_and_truth(lens, kind=kind)
    pixels, _ = predictions(problem, truth)
    holder = spindle_T_taper(cell.gamma_s_rad) @ problem.calibration.taper_T_camera
    for n, observation in enumerate(problem.observations):
        target = cell.part.target(observation.target_id)
        camera_T_part = (observation.machine_T_spindle @ holder).inverse() @ cell.machine_T_part
        normal = camera_T_part.rotation @ target.normal
        centre = camera_T_part @ target.xyz_mm
        (expected,) = project_circles(lens, [centre], [normal], [target.dot_diameter_mm], kind)
        assert np.allclose(pixels[n], expected, atol=1e-8)


def stepped(problem, at, step):
    rotation = np.empty((3, 3))
    rotate(at.rotation, *step[:3], rotation)
    moved = replace(
        at, rotation=rotation, d0_mm=at.d0_mm + step[3:6], gamma_s_rad=at.gamma_s_rad + step[6]
    )
    return predictions(problem, moved)[0]


@both
@pytest.mark.parametrize(
    "parameter", range(7), ids=["ω_x", "ω_y", "ω_z", "d_x", "d_y", "d_z", "γ_s"]
)
@pytest.mark.parametrize(("circles", "largest"), [(False, 1e-7), (True, 3e-4)])
def test_analytic_derivative_is_the_numeric_one(lens, parameter, circles, largest):
    """Exact for points; for circles to what test_circle_centre.py found."""
    _, problem, truth = problem_and_truth(lens)
    if not circles:
        problem = replace(problem, circles=problem.points)
    size = 1e-6 if parameter in (0, 1, 2, 6) else 1e-2
    h = size * np.eye(7)[parameter]
    numeric = (stepped(problem, truth, h) - stepped(problem, truth, -h)) / (2 * size)
    analytic = predictions(problem, truth)[1][:, :, parameter]
    assert np.abs(analytic - numeric).max() < largest * np.abs(numeric).max() + 1e-6


def test_theta_changes_with_the_local_unknowns_as_told():
    _, problem, truth = problem_and_truth(LENSES[0])
    for column in range(7):
        size = 1e-7 if column in (0, 1, 2, 6) else 1e-3
        values = []
        for sign in (1, -1):
            step = sign * size * np.eye(7)[column]
            rotation = np.empty((3, 3))
            rotate(truth.rotation, *step[:3], rotation)
            moved = replace(
                truth, rotation=rotation, d0_mm=truth.d0_mm + step[3:6],
                gamma_s_rad=truth.gamma_s_rad + step[6],
            )  # fmt: skip
            values.append(moved.theta(problem.X0_mm))
        numeric = (values[0] - values[1]) / (2 * size)
        assert np.allclose(
            truth.d_theta_d_local(problem.X0_mm)[:, column], numeric, rtol=1e-5, atol=1e-4
        )


def test_normal_equations_are_those_of_the_derivatives():
    _, problem, truth = problem_and_truth(LENSES[0])
    off = replace(truth, d0_mm=truth.d0_mm + np.array([0.1, -0.2, 0.3]))
    pixels, J = predictions(problem, off)
    w = problem.information
    W = np.stack([w[:, [0, 1]], w[:, [1, 2]]], axis=1)
    r = pixels - problem.measured
    N, g = np.empty((7, 7)), np.empty(7)
    state = State(off.rotation, off.d0_mm, np.array([off.gamma_s_rad]))
    cost = normal_equations(problem.model(), problem.seen, state, workspace(8), Normal(N, g))
    assert cost == pytest.approx(np.einsum("ni,nij,nj->", r, W, r))
    assert np.allclose(N, np.einsum("nia,nij,njb->ab", J, W, J), rtol=1e-10)
    assert np.allclose(g, np.einsum("nia,nij,nj->a", J, W, r), rtol=1e-9)


def test_rotation_step_is_rodrigues_near_identity_too():
    for angle in (0.0, 1e-9, 1e-4, 1.0, 3.0):
        axis = np.array([0.6, -0.48, 0.64])
        rotated = np.empty((3, 3))
        rotate(np.eye(3), *(angle * axis), rotated)
        quaternion = [*(np.sin(angle / 2) * axis), np.cos(angle / 2)]
        expected = RigidTransform.from_quaternion_xyzw(quaternion).rotation
        assert np.allclose(rotated, expected, atol=1e-15)


def test_a_start_that_does_not_see_the_targets_ends_without_a_solution():
    _, problem, truth = problem_and_truth(LENSES[0])
    away = Start(rotation=truth.rotation, d0_mm=truth.d0_mm + 1e6, gamma_s_rad=0.0, cost_mm2=0.0)
    found = refine(problem, SolveOptions(), away)
    assert not found.converged
    assert not np.isfinite(found.cost)


def test_what_the_camera_cannot_see_has_no_pixel_and_no_derivative():
    _, problem, truth = problem_and_truth(LENSES[0])
    behind = truth.d0_mm + 1e6 * (truth.d0_mm - problem.d_cnc.mean(axis=0))
    pixels, jacobians = np.zeros((len(problem), 2)), np.full((len(problem), 2, 7), np.inf)
    predict_all(problem.model(), truth.rotation, -behind, truth.gamma_s_rad, pixels, jacobians)
    unseen = np.isnan(pixels[:, 0])
    assert unseen.any()
    assert np.all(jacobians[unseen] == 0.0)
