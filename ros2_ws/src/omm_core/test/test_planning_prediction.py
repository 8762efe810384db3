"""The predicted covariance is what a solver that knows all noise has, and what errors then show."""

import dataclasses

import numpy as np
import pytest
from known_noise import KnownNoise, solve_knowing_all
from planning_cells import EXACT, REAL, part, scene

from omm_core.machine_errors import draw_geometry, draw_stop_noise, geometry_covariance
from omm_core.planning.candidates import find_candidates
from omm_core.planning.prediction import designs, own_covariances
from omm_core.planning.wish import PlanWish, Yardstick


def planned(cell, stops=10, seed=3):
    """Stops out of those that are possible, each target seen; designs of these alone."""
    candidates, unseen = find_candidates(cell, [{}])
    assert not unseen
    random = np.random.default_rng(seed)
    by_target = [np.flatnonzero(candidates.aimed_at == row) for row in range(4)]
    chosen = [int(random.choice(by_target[i % 4])) for i in range(stops)]
    spindles = [candidates.spindles[i] for i in chosen]
    views = candidates.views.only(np.array(chosen))
    views = dataclasses.replace(views, diameter_px=np.maximum(views.diameter_px, 74.0))
    return spindles, views


@pytest.mark.parametrize("noise", [REAL, EXACT])
@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (0.02, -0.03, 0.7)])
def test_own_covariance_is_that_of_the_independent_solver(noise, turned):
    cell = scene(noise, at=(600.0, 200.0, -100.0), turned=turned)
    spindles, seen = planned(cell)
    design = designs(cell, spindles, seen)
    covariance = own_covariances(design, noise, np.arange(len(spindles))[None])[0]
    theta = Yardstick.of(cell, PlanWish()).theta_covariance(covariance)
    stop, target = np.nonzero(seen.visible)
    near = np.array([*turned, *cell.machine_T_part.translation_mm, 0.0])
    places = np.array([s.translation_mm for s in spindles])
    known = KnownNoise(
        image_sigma_px=noise.image_sigma_px,
        stop_sigma_mm=noise.stop_sigma_mm,
        geometry=geometry_covariance(places, noise.geometry_sigma_mm, noise.geometry_length_mm),
        target_sigma_mm=0.02,
    )
    X = np.array([t.xyz_mm for t in cell.part.targets])
    expected = solve_knowing_all(
        near, X, stop, target, spindles, cell.calibration, np.zeros((len(stop), 2)), known
    ).own_covariance
    sigma = np.sqrt(np.diag(expected))
    # The independent one takes points for circles.
    assert np.sqrt(np.diag(theta)) == pytest.approx(sigma, rel=0.01)
    difference = (theta - expected) / np.outer(sigma, sigma)
    assert np.abs(difference).max() < 0.02


def test_geometry_that_only_shifts_and_turns_the_part_costs_no_own_uncertainty():
    long = type(REAL)(**{**REAL.__dict__, "geometry_length_mm": 1e6})
    none = REAL.without("geometry")
    cell = scene()
    spindles, seen = planned(cell)
    design = designs(cell, spindles, seen)
    every = np.arange(len(spindles))[None]
    with_it, without = (own_covariances(design, n, every)[0] for n in (long, none))
    assert np.diag(with_it) == pytest.approx(np.diag(without), rel=1e-3)


def test_more_of_the_same_cannot_get_below_what_targets_and_geometry_leave():
    cell = scene()
    spindles, seen = planned(cell, stops=8)
    design = designs(cell, spindles, seen)
    sigma = [
        np.sqrt(np.diag(own_covariances(design, REAL, np.tile(np.arange(8), n)[None])[0]))
        for n in (1, 2, 4)
    ]
    assert np.all(sigma[1] < sigma[0])
    assert np.all(sigma[2] > 0.5 * sigma[0])  # 0.5: were all noise the stops' own


def test_targets_that_are_exact_give_what_image_noise_alone_gives():
    exact = scene(EXACT, part=part(sigma_mm=0.0))
    spindles, seen = planned(exact)
    design = designs(exact, spindles, seen)
    assert design.common.shape[2] == 0
    every = np.arange(len(spindles))
    one = own_covariances(design, EXACT, every[None])[0]
    four = own_covariances(design, EXACT, np.tile(every, 4)[None])[0]
    assert np.allclose(one, 4.0 * four, rtol=1e-6, atol=0.0)


def test_errors_of_simulated_measurements_are_as_large_as_predicted():
    """Mean normalised squared error 7 within four standard deviations, over 500 linear runs."""
    cell = scene(at=(300.0, 100.0, -100.0))
    spindles, seen = planned(cell)
    design = designs(cell, spindles, seen)
    every = np.arange(len(spindles))
    covariance = own_covariances(design, REAL, every[None])[0]
    A, D = design.A.reshape(-1, 7), -design.A[..., 3:6]
    random = np.random.default_rng(5)
    places = np.array([s.translation_mm for s in spindles])
    from omm_core.planning.prediction import _fit, stacked

    V = stacked(design, REAL, every[None])[1][0]
    gain = covariance @ A.T @ np.linalg.inv(V)
    fit = np.moveaxis(_fit(design, every[None])[0], 0, 1).reshape(6, -1)
    squares = []
    for _ in range(500):
        geometry = draw_geometry(random, places, REAL.geometry_sigma_mm, REAL.geometry_length_mm)
        stops = draw_stop_noise(random, len(places), REAL.stop_sigma_mm)
        pixels = np.einsum("srj,sj->sr", D, geometry + stops).ravel()
        pixels += design.common.reshape(len(A), -1) @ random.normal(size=design.common.shape[2])
        pixels += np.sqrt(design.variance.ravel()) * random.normal(size=len(A))
        own_error = gain @ pixels
        own_error[:6] += fit @ geometry.ravel()
        squares.append(own_error @ np.linalg.solve(covariance, own_error))
    assert np.mean(squares) == pytest.approx(7.0, abs=0.67)


def test_correlations_of_a_survey_are_planned_with():
    """Targets that are all shifted together shift the part as far and turn it by nothing."""
    shift_mm = 0.05
    exact = scene(EXACT, part=part(sigma_mm=0.0), at=(600.0, 200.0, -100.0))
    count = len(exact.part.targets)
    together = np.kron(np.ones((count, count)), shift_mm**2 * np.eye(3))
    spindles, seen = planned(exact)
    every = np.arange(len(spindles))[None]

    def predicted(covariance):
        targets = tuple(
            dataclasses.replace(t, sigma_xyz_mm=np.full(3, shift_mm)) for t in exact.part.targets
        )
        measured = dataclasses.replace(exact.part, targets=targets, covariance_mm2=covariance)
        cell = dataclasses.replace(exact, part=measured)
        own = own_covariances(designs(cell, spindles, seen), EXACT, every)[0]
        return Yardstick.of(cell, PlanWish()).theta_covariance(own)

    design = designs(exact, spindles, seen)
    alone = own_covariances(design, EXACT, every)[0]
    alone = Yardstick.of(exact, PlanWish()).theta_covariance(alone)
    added = predicted(together) - alone
    size = np.r_[np.full(3, 1e-5), np.full(3, shift_mm), 1e-5]
    wanted = np.diag([0.0, 0.0, 0.0, *[shift_mm**2] * 3, 0.0])
    assert np.abs((added - wanted) / np.outer(size, size)).max() < 0.01
    apart = predicted(np.diag(np.diag(together))) - alone
    assert np.diag(apart)[:2].min() > (1e-5) ** 2  # without correlations it would seem to tilt
