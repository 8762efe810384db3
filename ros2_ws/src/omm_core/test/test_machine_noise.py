"""The pose on a machine that is not exact, and what is told of it: laws of the grid posterior."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import EXACT_MACHINE, bench_cell

from omm_core.errors import InputError
from omm_core.files.machine import MachineUncertainty
from omm_core.geometry import RigidTransform
from omm_core.part_pose import SolveOptions, build_problem, solve
from omm_core.part_pose.adjustment import adjust
from omm_core.part_pose.noise_model import noise_model
from omm_core.part_pose.posterior import WIDER, posterior

SIGMA_PX = 0.005


@pytest.fixture(scope="module")
def cell():
    return bench_cell(np.random.default_rng(21))


@pytest.fixture(scope="module")
def model(cell):
    observations = cell.noisy(np.random.default_rng(3), SIGMA_PX)
    problem = build_problem(observations, cell.part, cell.calibration)
    return noise_model(problem, adjust(problem, SolveOptions())[0], SolveOptions())


def erring(cell, random, stop_mm=0.0, geometry_mm=0.0, length_mm=700.0):
    """Return what is seen where the spindle is not where the control says, and the errors (I, 3).

    The camera moved by e sees what it would see of a part moved by -e.
    """
    from test_uncertainty import simulated

    places = np.array([o.machine_T_spindle.translation_mm for o in cell.observations])
    apart2 = np.sum((places[:, None] - places[None]) ** 2, axis=2)
    values, vectors = np.linalg.eigh(np.exp(-apart2 / (2 * length_mm**2)))
    geometry = vectors * np.sqrt(np.maximum(values, 0.0)) @ random.normal(size=places.shape)
    errors = stop_mm * random.normal(size=places.shape) + geometry_mm * geometry
    moved = tuple(
        replace(
            o,
            machine_T_spindle=RigidTransform(
                rotation=o.machine_T_spindle.rotation,
                translation_mm=o.machine_T_spindle.translation_mm + e,
            ),
        )
        for o, e in zip(cell.observations, errors)
    )
    seen = simulated(
        random, replace(cell, observations=moved), cell.part, cell.calibration, SolveOptions()
    )
    told = [
        replace(s, machine_T_spindle=o.machine_T_spindle, covariance_px2=np.eye(2) * SIGMA_PX**2)
        for s, o in zip(seen, cell.observations)
    ]
    return told, errors


@pytest.mark.parametrize("stop_um", [4, 8, 20])
@pytest.mark.parametrize("geometry_um", [0, 15, 50])
def test_a_machine_with_errors_is_solved_and_its_noise_told(cell, stop_um, geometry_um):
    random = np.random.default_rng(100 * stop_um + geometry_um)
    for _ in range(3):
        seen, _ = erring(cell, random, stop_um / 1e3, geometry_um / 1e3)
        solution = solve(seen, cell.part, cell.calibration)
        assert solution.determined
        assert solution.machine.stop_sigma_mm.high >= stop_um / 2e3
        assert np.all(solution.expanded_uncertainty > 0.0)


def test_a_shift_and_turn_of_all_stops_does_nothing_to_own_coordinates(model):
    """What no run can see is not in the statement that is believable: r f takes it out."""
    places, rotation = model.places_mm, model.adjustment.rotation
    centre = model.adjustment.d0_mm
    random = np.random.default_rng(1)
    for _ in range(5):
        shift, turn = random.normal(size=3), random.normal(size=3) * 1e-3
        arms = (model.problem.points[model.problem.target_of, 0] @ rotation.T)[
            np.searchsorted(model.problem.image_of, np.arange(len(places)))
        ]
        errors = (shift + np.cross(turn, arms)).ravel()
        assert np.allclose(model.rigid @ errors, np.r_[turn, shift, 0.0], atol=1e-9)
    assert np.isfinite(centre).all()


def test_split_tells_pose_and_noise_apart(model):
    u = model.unknowns
    from omm_core.part_pose.adjustment import predictions

    _, J = predictions(model.problem, model.adjustment)
    white = (model.whitening @ J).reshape(-1, 7)
    assert np.allclose(model.split @ white, np.eye(len(model.split))[:, :u], atol=1e-7)
    K = model.split[u:]
    assert np.allclose(K @ K.T, np.eye(len(K)), atol=1e-12)


def test_one_machine_gives_generalised_least_squares(model):
    """With everything declared the mixture is one normal distribution: textbook formulas."""
    options = SolveOptions(stop_sigma_mm=0.004, geometry_sigma_mm=0.02, geometry_length_mm=500.0)
    found = posterior(model, options)
    assert len(found.weight) == 1
    from omm_core.part_pose.adjustment import predictions

    pixels, J = predictions(model.problem, model.adjustment)
    A = (model.whitening @ J).reshape(-1, 7)
    D = np.linalg.inv(model.split) @ model.stops
    y = np.einsum("nij,nj->ni", model.whitening, model.problem.measured - pixels).ravel()
    places = model.problem.d_cnc
    kernel = np.exp(-np.sum((places[:, None] - places[None]) ** 2, axis=2) / (2 * 500.0**2))
    F = 0.02**2 * np.kron(kernel, np.eye(3))
    for own, effect in ((False, D), (True, D + A @ model.rigid)):
        V = np.eye(len(y)) + 0.004**2 * D @ D.T + effect @ F @ effect.T
        covariance = np.linalg.inv(A.T @ np.linalg.solve(V, A))
        delta = covariance @ A.T @ np.linalg.solve(V, y)
        sigma = np.sqrt(np.diag(covariance))
        assert np.allclose(found.local_mean(own=own), delta, atol=1e-6 * sigma.min())
        assert np.allclose(
            found.local_covariance(own=own) / np.outer(sigma, sigma),
            covariance / np.outer(sigma, sigma), atol=1e-6,
        )  # fmt: skip
        statement = found.statement(own=own)
        expected = 2.0000024 * np.sqrt(np.diag(statement.covariance))  # 95.45 % of a normal
        assert np.allclose(statement.expanded_uncertainty, expected, rtol=1e-4)


def test_own_and_absolute_are_the_same_where_the_geometry_is_exact(cell):
    options = SolveOptions(geometry_sigma_mm=0.0)
    seen, _ = erring(cell, np.random.default_rng(5), stop_mm=0.004)
    solution = solve(seen, cell.part, cell.calibration, options)
    assert np.array_equal(solution.own.theta, solution.absolute.theta)
    assert np.array_equal(solution.own.expanded_uncertainty, solution.absolute.expanded_uncertainty)
    assert solution.geometry_declared


def test_u_is_the_half_width_of_the_mixture(model):
    """95.45 % of a large sample of the mixture lie within U of its mean."""
    found = posterior(model, SolveOptions())
    statement = found.statement(own=True)
    random = np.random.default_rng(2)
    picks = random.choice(len(found.weight), 40_000, p=found.weight)
    to_theta = model.adjustment.d_theta_d_local(model.problem.X0_mm)
    means = found.deltas[:, 0] @ to_theta.T
    sigmas = np.sqrt(np.einsum("ij,pjk,ik->pi", to_theta, found.covariances[:, 0], to_theta))
    sample = means[picks] + sigmas[picks] * random.normal(size=(40_000, 7))
    off = np.abs(sample - found.weight @ means)
    share = np.mean(off <= statement.expanded_uncertainty / WIDER, axis=0)
    assert np.all(np.abs(share - 0.9545) < 4 * np.sqrt(0.9545 * 0.0455 / 40_000))


def test_exact_machine_gives_the_least_squares_result(cell):
    options = SolveOptions(**EXACT_MACHINE, find_errors=False)
    observations = cell.noisy(np.random.default_rng(3), SIGMA_PX)
    solution = solve(observations, cell.part, cell.calibration, options)
    problem = build_problem(observations, cell.part, cell.calibration)
    best = adjust(problem, options)[0]
    sigma = np.sqrt(np.diag(solution.covariance))
    assert np.all(np.abs(solution.theta - best.theta(problem.X0_mm)) < 1e-4 * sigma)


def test_the_same_input_gives_the_same_bits_in_any_order(cell):
    seen, _ = erring(cell, np.random.default_rng(8), 0.004, 0.015)
    one = solve(seen, cell.part, cell.calibration)
    other = solve(seen[::-1], cell.part, cell.calibration)
    for name in ("theta", "covariance", "expanded_uncertainty"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
    assert one.remarks == other.remarks


def test_what_is_not_told_of_targets_is_said(cell):
    seen, _ = erring(cell, np.random.default_rng(8), 0.004)
    assert any(
        "count as exact" in words for words in solve(seen, cell.part, cell.calibration).remarks
    )
    told = replace(
        cell.part,
        targets=tuple(replace(t, sigma_xyz_mm=np.zeros(3)) for t in cell.part.targets),
    )
    assert not any("count as exact" in w for w in solve(seen, told, cell.calibration).remarks)


def test_what_is_declared_fixes_the_grid_and_what_is_set_stays():
    options = SolveOptions(stop_sigma_mm=0.002).of_machine(
        MachineUncertainty(stop_sigma_mm=0.009, geometry_sigma_mm=0.03)
    )
    assert (options.stop_sigma_mm, options.geometry_sigma_mm) == (0.002, 0.03)
    assert options.geometry_length_mm is None


@pytest.mark.parametrize(
    "bad",
    [{"stop_sigma_mm": -1.0}, {"geometry_sigma_mm": np.nan}, {"geometry_length_mm": 0.0},
     {"worst_machine_mm": 0.0}],
)  # fmt: skip
def test_a_bad_number_is_refused(bad):
    with pytest.raises(InputError, match=next(iter(bad))):
        SolveOptions(**bad)


def repeated(seen, times):
    """Return each observation so many times in a row, taken without moving in between."""
    return [
        replace(o, stamp_ns=o.stamp_ns + 1000 * k, center_px=o.center_px + 1e-3 * k)
        for o in seen
        for k in range(times)
    ]


def test_images_from_one_place_do_not_average_the_stop_out(cell):
    options = SolveOptions(stop_sigma_mm=0.006, geometry_sigma_mm=0.0)
    seen, _ = erring(cell, np.random.default_rng(8), 0.006)
    once = solve(seen, cell.part, cell.calibration, options)
    often = solve(repeated(seen, 5), cell.part, cell.calibration, options)
    ratio = often.expanded_uncertainty / once.expanded_uncertainty
    assert np.all((ratio > 0.95) & (ratio < 1.01))


def test_of_very_many_centres_evenly_spread_ones_are_used_and_all_are_accounted_for(cell):
    seen, _ = erring(cell, np.random.default_rng(8), 0.006)
    many = repeated(seen, 40)
    solution = solve(many, cell.part, cell.calibration)
    assert solution.determined
    assert len(solution.used) == len(solution.reasons) == 320
    assert solution.used.sum() == 200
    left = [r for r, used in zip(solution.reasons, solution.used) if not used]
    assert all("evenly spread" in reason for reason in left)
    assert solution.findings == ()
