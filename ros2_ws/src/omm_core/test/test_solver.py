"""From nothing to the optimum, the special cases of the literature, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import BACKLASH_RAD, EXACT_MACHINE, PAPER_CALIBRATION, bench_cell, random_cell
from reference_model import predict

from omm_core.errors import InputError
from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform, rotation_from_euler_xyz_rad
from omm_core.imaging.calibration import CameraCalibration
from omm_core.imaging.lens import BrownPhotogrammetric
from omm_core.part_pose import Observation, SolveOptions, build_problem, solve
from omm_core.part_pose.adjustment import adjust, refine
from omm_core.part_pose.start import Start

PLAIN = SolveOptions(find_errors=False, **EXACT_MACHINE)


def truth_start(cell, problem):
    return Start(
        rotation=cell.machine_T_part.rotation,
        d0_mm=cell.machine_T_part @ problem.X0_mm,
        gamma_s_rad=cell.gamma_s_rad,
        cost_mm2=0.0,
    )


@pytest.mark.parametrize("model", ["7d", "6d"])
def test_from_nothing_the_optimum_is_that_of_a_solver_started_at_the_truth(model):
    """150 random cells here; bench/solver.py tries 10,000."""
    random = np.random.default_rng(11)
    for _ in range(75):
        cell = random_cell(random)
        options = SolveOptions(model=model, gamma_s_rad=cell.gamma_s_rad)
        problem = build_problem(cell.noisy(random, 0.05), cell.part, cell.calibration)
        found = adjust(problem, options)[0]
        reference = refine(problem, options, truth_start(cell, problem))
        assert found.converged
        assert found.cost == pytest.approx(reference.cost, rel=1e-7)
        assert np.abs(found.rotation - reference.rotation).max() < 1e-9


def test_large_dots_close_by_converge_in_a_few_steps() -> None:
    """Their derivatives are right to 1e-5 only: the last steps may seem to raise the cost."""
    random = np.random.default_rng(3)
    for _ in range(20):
        cell = random_cell(random, dot_diameter_mm=45.0)
        start = Start(
            rotation=cell.machine_T_part.rotation,
            d0_mm=np.zeros(3),
            gamma_s_rad=cell.gamma_s_rad,
            cost_mm2=0.0,
        )
        for _ in range(3):
            problem = build_problem(cell.noisy(random, 0.02), cell.part, cell.calibration)
            start = replace(start, d0_mm=cell.machine_T_part @ problem.X0_mm)
            found = refine(problem, SolveOptions(), start)
            assert found.converged
            assert found.iterations <= 6


def test_without_noise_the_truth_comes_out():
    cell = bench_cell(np.random.default_rng(2))
    solution = solve(cell.observations, cell.part, cell.calibration)
    assert solution.determined
    assert solution.converged
    assert np.allclose(solution.theta, cell.theta, atol=1e-8)
    assert solution.rms_px < 1e-9


def test_the_result_does_not_depend_on_the_order_of_observations():
    random = np.random.default_rng(2)
    cell = bench_cell(random)
    observations = cell.noisy(random, 0.05)
    one = solve(observations, cell.part, cell.calibration)
    other = solve(observations[::-1], cell.part, cell.calibration)
    assert np.array_equal(one.theta, other.theta)
    assert np.array_equal(one.covariance, other.covariance)


def test_in_6d_gamma_s_is_given_and_has_no_covariance():
    random = np.random.default_rng(4)
    cell = bench_cell(random)
    options = SolveOptions(model="6d", gamma_s_rad=cell.gamma_s_rad)
    solution = solve(cell.noisy(random, 0.05), cell.part, cell.calibration, options)
    assert solution.theta[6] == pytest.approx(cell.gamma_s_rad)
    assert not solution.covariance[6].any()
    assert not solution.covariance[:, 6].any()
    assert solution.degrees_of_freedom == 2 * 8 - 6


def test_holder_turned_by_any_angle_is_found():
    random = np.random.default_rng(8)
    for gamma_s in (-3.0, -1.5, 1.0, 2.5):
        cell = random_cell(random)
        while abs(cell.gamma_s_rad) < BACKLASH_RAD:
            cell = random_cell(random)
        solution = solve(cell.noisy(random, 0.05), cell.part, cell.calibration, PLAIN)
        off = solution.theta[6] - cell.gamma_s_rad
        assert abs(np.sin(off / 2)) < 5e-3, gamma_s


# ---------------------------------------------------------------- agreement with other solvers


def paper_problem():
    """Return the bench with point targets (the paper's own model) and its plain residuals."""
    random = np.random.default_rng(6)
    cell = bench_cell(random)
    observations = cell.noisy(random, 0.05)
    problem = build_problem(observations, cell.part, cell.calibration)
    problem = replace(problem, circles=problem.points)

    def residuals(theta):
        predicted = [
            predict(
                cell.calibration.lens, theta, cell.part.target(o.target_id).xyz_mm,
                o.machine_T_spindle, cell.calibration.taper_T_camera,
            )
            for o in problem.observations
        ]  # fmt: skip
        r = np.concatenate([p - o.center_px for (p, _), o in zip(predicted, problem.observations)])
        return r / 0.05, np.concatenate([J for _, J in predicted]) / 0.05

    ours = adjust(problem, PLAIN)[0].theta(problem.X0_mm)
    return ours, residuals


def test_scipy_finds_the_same_optimum():
    from scipy.optimize import least_squares

    ours, residuals = paper_problem()
    theirs = least_squares(
        lambda t: residuals(t)[0], np.zeros(7), jac=lambda t: residuals(t)[1],
        x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15,
    )  # fmt: skip
    assert np.allclose(ours, theirs.x, rtol=1e-9, atol=1e-9)


def test_pyceres_finds_the_same_optimum():
    pyceres = pytest.importorskip("pyceres", reason="pyceres is not installed")
    ours, residuals = paper_problem()

    class Cost(pyceres.CostFunction):
        def __init__(self):
            super().__init__()
            self.set_num_residuals(16)
            self.set_parameter_block_sizes([7])

        def Evaluate(self, parameters, out, jacobians):
            r, J = residuals(parameters[0])
            out[:] = r
            if jacobians is not None:
                jacobians[0][:] = J.ravel()
            return True

    theta = np.zeros(7)
    problem, cost = pyceres.Problem(), Cost()
    problem.add_residual_block(cost, None, [theta])
    options = pyceres.SolverOptions()
    options.max_num_iterations = 100
    options.function_tolerance = options.parameter_tolerance = options.gradient_tolerance = 1e-16
    options.minimizer_progress_to_stdout = False
    pyceres.solve(options, problem, pyceres.SolverSummary())
    assert np.allclose(ours, theta, rtol=1e-9, atol=1e-9)


def test_circles_left_to_a_numeric_derivative_move_the_optimum_by_a_thousandth_of_sigma():
    from scipy.optimize import least_squares

    from omm_core.part_pose.adjustment import predictions

    random = np.random.default_rng(6)
    cell = bench_cell(random)
    problem = build_problem(cell.noisy(random, 0.05), cell.part, cell.calibration)
    ours = adjust(problem, PLAIN)[0]
    X0, scale = problem.X0_mm, np.array([1e-3] * 3 + [1.0] * 3 + [1e-3])

    def residuals(theta):
        pose = RigidTransform.from_euler_xyz_rad(*theta[:3], translation_mm=theta[3:6])
        at = replace(
            ours, rotation=pose.rotation.copy(), d0_mm=pose @ X0, gamma_s_rad=float(theta[6])
        )
        return (predictions(problem, at)[0] - problem.measured).ravel() / 0.05

    theta = ours.theta(X0)
    theirs = least_squares(
        lambda s: residuals(theta + s * scale), np.zeros(7), jac="3-point", xtol=1e-15, ftol=1e-15
    )
    to_theta = ours.d_theta_d_local(X0)
    sigma = np.sqrt(np.diag(to_theta @ np.linalg.inv(ours.normal) @ to_theta.T))
    assert np.abs(theirs.x * scale / sigma).max() < 1e-3


# ------------------------------------------------------------------------------- resection


def test_a_single_image_is_the_textbooks_resection():
    """Four control points, f = 153.24 mm: centre, angles and standard deviations as published.

    One image with the spindle at the origin: the part's pose in the camera is the camera's in the
    world, turned round. The photo's x, y are right and up, the camera looks along -z.
    """
    f = 153.24
    image_mm = np.array([[-86.15, -68.99], [-53.40, 82.21], [-14.78, -76.63], [10.46, 64.43]])
    world_m = np.array(
        [
            [36589.41, 25273.32, 2195.17],
            [37631.08, 31324.51, 728.69],
            [39100.97, 24934.98, 2386.50],
            [40426.54, 30319.81, 757.31],
        ]
    )
    pixel = 0.01  # mm; the plate is 230 mm wide
    lens = BrownPhotogrammetric(
        width_px=23001, height_px=23001, focal_length_mm=f, pixel_size_mm=pixel
    )
    calibration = CameraCalibration(
        name="plate", lens=lens, taper_T_camera=RigidTransform.identity(),
        covariance=np.zeros((0, 0)),
    )  # fmt: skip
    origin_m = world_m.mean(axis=0)
    part = Part(
        name="ground", target_family="metashape12",
        targets=tuple(
            Target(id=i + 1, xyz_mm=X - origin_m, dot_diameter_mm=1e-6)  # "mm" stands for m
            for i, X in enumerate(world_m)
        ),
    )  # fmt: skip
    observations = [
        Observation(
            stamp_ns=1, target_id=i + 1, machine_T_spindle=RigidTransform.identity(),
            center_px=np.array([x, -y]) / pixel + 11500.0, covariance_px2=np.eye(2),
        )
        for i, (x, y) in enumerate(image_mm)
    ]  # fmt: skip
    options = SolveOptions(model="6d", find_errors=False, **EXACT_MACHINE)
    problem = build_problem(observations, part, calibration)
    problem = replace(problem, circles=problem.points)
    found = adjust(problem, options)[0]
    camera_R_world, d = found.rotation, found.d0_mm - found.rotation @ problem.X0_mm
    centre = -camera_R_world.T @ d + origin_m
    assert np.allclose(centre, [39795.45, 27476.46, 7572.69], atol=0.01)
    # Photo axes: x right, y up, z backward = camera's x, -y, -z. R = R_φ R_ω R_κ, photo to world.
    world_R_photo = camera_R_world.T @ np.diag([1.0, -1.0, -1.0])
    phi = np.arctan2(-world_R_photo[0, 2], world_R_photo[2, 2])
    omega = np.arcsin(-world_R_photo[1, 2])
    kappa = np.arctan2(world_R_photo[1, 0], world_R_photo[1, 1])
    assert np.allclose([phi, omega, kappa], [-0.00399, 0.00211, -0.06758], atol=1e-5)
    # Standard deviations with σ0 from the residuals (2 degrees of freedom): of the centre, which
    # is -Rᵀ d: by the local unknowns (ω, d_0) it changes with -Rᵀ (δd_0 - ω x d_0).
    by_turn = camera_R_world.T @ np.cross(np.eye(3), found.d0_mm).T
    to_centre = np.hstack([by_turn, -camera_R_world.T])
    sigma0_2 = found.cost / (2 * 4 - 6)
    covariance = to_centre @ np.linalg.inv(found.normal[:6, :6]) @ to_centre.T * sigma0_2
    assert np.allclose(np.sqrt(np.diag(covariance)), [1.107, 1.249, 0.488], atol=0.001)


# --------------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    "bad",
    [
        {"target_id": 5},
        {"center_px": np.array([np.nan, 1.0])},
        {"covariance_px2": np.zeros((2, 2))},
        {"covariance_px2": np.diag([1.0, -1.0])},
    ],
)
def test_malformed_observations_are_refused(bad):
    cell = bench_cell(np.random.default_rng(1))
    observations = [replace(cell.observations[0], **bad), *cell.observations[1:]]
    with pytest.raises(InputError, match="Expected"):
        solve(observations, cell.part, cell.calibration)


def test_one_image_with_two_poses_is_refused():
    cell = bench_cell(np.random.default_rng(1))
    one, other = cell.observations[:2]
    with pytest.raises(InputError, match="one pose"):
        solve([one, replace(other, stamp_ns=one.stamp_ns)], cell.part, cell.calibration)


def test_unknown_model_is_refused():
    with pytest.raises(InputError, match="8d"):
        SolveOptions(model="8d")


def test_gimbal_lock_of_the_reported_angles_does_not_stop_the_solution():
    random = np.random.default_rng(3)
    cell = bench_cell(random)
    upright = RigidTransform(
        rotation=rotation_from_euler_xyz_rad(0.3, np.pi / 2, 0.0), translation_mm=np.zeros(3)
    )
    # The same machine, seen from the side: everything turned by 90° about y.
    observations = [
        replace(o, machine_T_spindle=upright @ o.machine_T_spindle) for o in cell.observations
    ]
    solution = solve(observations, cell.part, PAPER_CALIBRATION, PLAIN)
    assert solution.determined
    expected = upright @ cell.machine_T_part
    found = RigidTransform.from_euler_xyz_rad(
        *solution.theta[:3], translation_mm=solution.theta[3:6]
    )
    assert np.allclose(found.rotation, expected.rotation, atol=1e-8)
