"""Is the covariance right? Against Monte Carlo, with and without each source of uncertainty.

OMM_RUNS=2000 makes the table that docs/statistics.md quotes.
"""

import os
from dataclasses import replace

import numpy as np
import pytest
from core_cells import PAPER_CALIBRATION, bench_cell

from omm_core.geometry import RigidTransform
from omm_core.part_pose import SolveOptions, build_problem, solve
from omm_core.part_pose.adjustment import Adjustment, adjust, predictions, refine
from omm_core.part_pose.posterior import STOPS
from omm_core.part_pose.start import Start
from omm_core.part_pose.uncertainty import CALIBRATION, IMAGE, TARGETS, propagate

SIGMA_PX = 0.02
RUNS = int(os.environ.get("OMM_RUNS", "300"))
# k = 99 % interval of a mean of RUNS values of χ² with n degrees of freedom, near normal.
HALF_WIDTH = 2.576 * np.sqrt(2.0 / RUNS)

PARAMETERS = ("focal_length_mm", "cl0_px", "x_mm", "y_mm", "z_mm", "alpha_rad", "gamma_rad")


def calibration_covariance():
    """Return a covariance with the correlation that calibrations have: f with z."""
    sigma = np.array([0.0006, 0.05, 0.004, 0.004, 0.03, 2e-5, 2e-5])
    correlation = np.eye(len(sigma))
    correlation[0, 4] = correlation[4, 0] = -0.9
    return np.outer(sigma, sigma) * correlation


SOURCES = {
    "centres": {},
    "targets": {"target_sigma_mm": np.array([0.01, 0.02, 0.03])},
    "machine": {"stop_sigma_mm": 0.005},
    "calibration": {"calibrated": True},
    "all": {
        "target_sigma_mm": np.array([0.01, 0.02, 0.03]),
        "stop_sigma_mm": 0.005,
        "calibrated": True,
    },
}


def uncertain_cell(target_sigma_mm=None, calibrated=False):
    """Return a cell, and what the estimator is told of it."""
    cell = bench_cell(np.random.default_rng(31))
    targets = tuple(replace(t, sigma_xyz_mm=target_sigma_mm) for t in cell.part.targets)
    calibration = cell.calibration
    if calibrated:
        calibration = replace(
            calibration, parameters=PARAMETERS, covariance=calibration_covariance()
        )
    return cell, replace(cell.part, targets=targets), calibration


def simulated(random, cell, part, calibration, options):
    """Return observations of a cell in which everything uncertain is drawn anew."""
    true_calibration = calibration
    if calibration.parameters:
        values = calibration.parameter_values(calibration.parameters)
        drawn = random.multivariate_normal(values, calibration.covariance)
        true_calibration = calibration.with_parameters(calibration.parameters, drawn)
    true_targets = tuple(
        replace(t, xyz_mm=t.xyz_mm + random.normal(0, 1, 3) * t.sigma_xyz_mm)
        if t.sigma_xyz_mm is not None
        else t
        for t in part.targets
    )
    true_poses = [
        replace(
            o,
            machine_T_spindle=RigidTransform(
                rotation=o.machine_T_spindle.rotation,
                translation_mm=o.machine_T_spindle.translation_mm
                + random.normal(0, options.stop_sigma_mm or 0.0, 3),
            ),
        )
        for o in cell.observations
    ]
    true = build_problem(true_poses, replace(part, targets=true_targets), true_calibration)
    truth = Adjustment(
        rotation=cell.machine_T_part.rotation, d0_mm=cell.machine_T_part @ true.X0_mm,
        gamma_s_rad=cell.gamma_s_rad, cost=0.0, normal=np.zeros((7, 7)), converged=True,
        iterations=0,
    )  # fmt: skip
    pixels = predictions(true, truth)[0]
    return [
        replace(
            o,
            center_px=pixel + random.normal(0, SIGMA_PX, 2),
            covariance_px2=np.eye(2) * SIGMA_PX**2,
        )
        for o, pixel in zip(cell.observations, pixels)
    ]


def errors_and_covariance(source, model, runs=RUNS):
    given = dict(SOURCES[source])
    options = SolveOptions(model=model, stop_sigma_mm=given.pop("stop_sigma_mm", 0.0))
    cell, part, calibration = uncertain_cell(**given)
    options = replace(options, gamma_s_rad=cell.gamma_s_rad)
    random = np.random.default_rng(7)
    errors, normalised = [], []
    u = options.unknowns
    for _ in range(runs):
        problem = build_problem(
            simulated(random, cell, part, calibration, options), part, calibration
        )
        start = Start(
            rotation=cell.machine_T_part.rotation, d0_mm=cell.machine_T_part @ problem.X0_mm,
            gamma_s_rad=cell.gamma_s_rad, cost_mm2=0.0,
        )  # fmt: skip
        found = propagate(problem, refine(problem, options, start), options)
        to_theta = found.adjustment.d_theta_d_local(problem.X0_mm)
        covariance = (to_theta @ found.covariance @ to_theta.T)[:u, :u]
        error = (found.adjustment.theta(problem.X0_mm) - cell.theta)[:u]
        errors.append(error)
        normalised.append(error @ np.linalg.solve(covariance, error))
    return np.array(errors), covariance, np.array(normalised)


@pytest.mark.parametrize(
    ("model", "source"), [*(("7d", source) for source in SOURCES), ("6d", "centres"), ("6d", "all")]
)
def test_normalised_squared_errors_are_chi_squared(source, model):
    _, covariance, normalised = errors_and_covariance(source, model)
    unknowns = len(covariance)
    mean = normalised.mean() / unknowns
    print(f"NEES {model} {source}: {normalised.mean():.3f} of {unknowns}")
    assert abs(mean - 1.0) < HALF_WIDTH / np.sqrt(unknowns)


@pytest.mark.parametrize("source", ["centres", "all"])
def test_monte_carlo_deviations_are_those_of_the_covariance(source):
    errors, covariance, _ = errors_and_covariance(source, "7d")
    ratio = errors.std(axis=0) / np.sqrt(np.diag(covariance))
    assert np.all(np.abs(ratio - 1.0) < 3.5 / np.sqrt(2 * RUNS))


def test_what_is_left_out_of_the_covariance_is_missed():
    """The test above can fail: without the targets' sigma the covariance is far too small."""
    given = SOURCES["targets"]
    cell, part, calibration = uncertain_cell(**given)
    random = np.random.default_rng(7)
    options = SolveOptions(use_target_sigma=False, find_errors=False)
    normalised = []
    for _ in range(40):
        observations = simulated(random, cell, part, calibration, options)
        problem = build_problem(observations, part, calibration)
        found = propagate(problem, adjust(problem, options)[0], options)
        to_theta = found.adjustment.d_theta_d_local(problem.X0_mm)
        error = found.adjustment.theta(problem.X0_mm) - cell.theta
        covariance = to_theta @ found.covariance @ to_theta.T
        normalised.append(error @ np.linalg.solve(covariance, error))
    assert np.mean(normalised) > 3 * 7


def test_the_sandwich_without_other_sources_is_the_inverse_normal_matrix():
    cell = bench_cell(np.random.default_rng(1))
    problem = build_problem(cell.observations, cell.part, cell.calibration)
    found = adjust(problem, SolveOptions())[0]
    propagation = propagate(problem, found, SolveOptions())
    assert np.allclose(propagation.covariance, np.linalg.inv(found.normal), rtol=1e-6)
    assert np.allclose(propagation.shares[IMAGE], propagation.covariance, rtol=1e-9)


def test_shares_sum_to_one_and_name_what_dominates():
    cell, part, calibration = uncertain_cell(
        target_sigma_mm=np.array([0.001, 0.001, 0.05]), calibrated=True
    )
    options = SolveOptions(stop_sigma_mm=0.005, geometry_sigma_mm=0.0)
    observations = simulated(np.random.default_rng(3), cell, part, calibration, options)
    shares = solve(observations, part, calibration, options).shares
    assert set(shares) == {IMAGE, STOPS, TARGETS, CALIBRATION}
    assert np.allclose(sum(shares.values()), 1.0, atol=1e-9)
    assert shares[TARGETS][0] > 0.8  # α stands on the targets' z
    assert shares[CALIBRATION][5] > 0.2  # z on what the calibration calls z and f


def test_calibration_errors_do_not_average_out():
    """Four times the images between the same ends: the centres' part shrinks, the other stays."""
    shares = {}
    for images in (2, 8):
        cell = bench_cell(np.random.default_rng(2), images_per_target=images)
        calibration = replace(
            PAPER_CALIBRATION, parameters=PARAMETERS, covariance=calibration_covariance()
        )
        problem = build_problem(cell.observations, cell.part, calibration)
        found = propagate(problem, adjust(problem, SolveOptions())[0], SolveOptions())
        shares[images] = {name: np.diag(share)[:6] for name, share in found.shares.items()}
    z = 5
    assert shares[8][IMAGE][z] < 0.6 * shares[2][IMAGE][z]
    assert shares[8][CALIBRATION][z] > 0.9 * shares[2][CALIBRATION][z]


def test_a_calibration_covariance_that_is_singular_serves():
    names = ("z_mm", "focal_length_mm", "cl0_px")
    covariance = np.diag([4e-4, 1e-8, 0.0])
    covariance[0, 1] = covariance[1, 0] = 2e-6  # fully correlated
    cell = bench_cell(np.random.default_rng(2))
    calibration = replace(PAPER_CALIBRATION, parameters=names, covariance=covariance)
    solution = solve(cell.observations, cell.part, calibration)
    assert np.linalg.eigvalsh(solution.covariance).min() > 0
    assert solution.shares[CALIBRATION][5] > 0.1
