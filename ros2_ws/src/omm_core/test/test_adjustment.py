"""The general adjustment: truths are found, with the spread it promises, and gaps are told."""

import numpy as np
import pytest

from omm_core.adjustment import (
    Block,
    Group,
    Problem,
    rigid_directions,
    similarity_directions,
    solve,
)
from omm_core.adjustment import test_observations as observation_tests
from omm_core.adjustment.normal_equations import linearise
from omm_core.adjustment.parting import apart

SIGMA = 0.01


def distances(points, noise, sigma=None, datum=None, held=None):
    """All distances between points in the plane z = 0 and outside, a free network."""
    a, b = np.triu_indices(len(points), 1)

    def evaluate(values):
        p = values["points"]
        difference = p[a] - p[b]
        length = np.linalg.norm(difference, axis=1)
        unit = (difference / length[:, None])[:, None, :]
        return length[:, None], {"points": unit, "points:2": -unit}

    observed = evaluate({"points": points})[0] + noise[:, None]
    return Problem(
        groups=(Group(name="points", values=points + 0.1, sigma=sigma, held=held),),
        blocks=(
            Block(
                name="lengths",
                observed=observed,
                covariance=np.full((len(a), 1, 1), SIGMA**2),
                index={"points": a, "points:2": b},
                evaluate=evaluate,
            ),
        ),
        datum=datum or {},
    )


@pytest.fixture
def points():
    return np.random.default_rng(1).uniform(-5, 5, (7, 3))


def test_errors_over_the_covariance_are_as_promised(points):
    rng = np.random.default_rng(2)
    total, sigma0 = 0.0, 0.0
    for _ in range(60):
        problem = distances(
            points, rng.normal(0, SIGMA, 21), datum={"points": rigid_directions(points)}
        )
        solution = solve(problem)
        assert solution.converged
        assert not solution.undetermined
        assert solution.degrees_of_freedom == 21 - 21 + 6
        length = np.linalg.norm(solution.values["points"][0] - solution.values["points"][1])
        unit = np.zeros((7, 3))
        unit[0] = (points[0] - points[1]) / np.linalg.norm(points[0] - points[1])
        unit[1] = -unit[0]
        variance = unit.ravel() @ solution.covariance @ unit.ravel()
        total += (length - np.linalg.norm(points[0] - points[1])) ** 2 / variance
        sigma0 += solution.sigma0**2
    assert 30 < total < 105  # chi-square of 60, 4 sigma and more
    assert 0.7 < sigma0 / 60 < 1.35


def test_the_covariance_in_the_datum_is_the_pseudo_inverse(points):
    solution = solve(distances(points, np.zeros(21), datum={"points": rigid_directions(points)}))
    jacobian = np.zeros((21, 21))
    a, b = np.triu_indices(7, 1)
    for i, (j, k) in enumerate(zip(a, b, strict=True)):
        unit = points[j] - points[k]
        jacobian[i, 3 * j : 3 * j + 3] = unit / np.linalg.norm(unit)
        jacobian[i, 3 * k : 3 * k + 3] = -unit / np.linalg.norm(unit)
    wanted = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-10) * SIGMA**2
    assert np.abs(solution.covariance - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_directions_without_a_datum_are_found_and_span_the_rigid_motions(points):
    solution = solve(distances(points, np.zeros(21)))
    assert len(solution.undetermined) == 6
    space = np.linalg.qr(rigid_directions(solution.values["points"]))[0]
    for found in solution.undetermined:
        unit = found.direction / np.linalg.norm(found.direction)
        assert np.linalg.norm(space.T @ unit) == pytest.approx(1.0, abs=1e-5)


def test_held_values_settle_the_datum_and_stay(points):
    held = np.zeros((7, 3), dtype=bool)
    held[0] = held[1] = True
    held[2, 2] = True
    problem = distances(points, np.zeros(21), held=held)
    solution = solve(problem)
    assert np.all(solution.values["points"][held] == (points + 0.1)[held])
    assert np.all(solution.covariance_of("points")[:3] == 0.0)


def test_an_observed_group_with_full_covariance_is_a_prior(points):
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 3))
    group = Group(
        name="x", values=np.zeros((1, 3)), covariance=root @ root.T, observed=np.ones((1, 3))
    )
    solution = solve(Problem(groups=(group,), blocks=()))
    assert solution.values["x"] == pytest.approx(np.ones((1, 3)))
    assert solution.covariance == pytest.approx(root @ root.T, rel=1e-9)


def test_a_blunder_has_the_largest_w_and_redundancies_sum_to_the_freedom(points):
    noise = np.random.default_rng(3).normal(0, SIGMA, 21)
    noise[5] += 40 * SIGMA
    problem = distances(points, noise, datum={"points": rigid_directions(points)})
    solution = solve(problem)
    tests = observation_tests(problem, solution)["lengths"]
    assert np.argmax(np.abs(tests.w)) == 5
    assert tests.redundancy.sum() == pytest.approx(solution.degrees_of_freedom, abs=1e-6)
    assert tests.t2 == pytest.approx(tests.w[:, 0] ** 2)


def test_similarity_directions_are_shift_turn_and_scale(points):
    turned = points + 1e-7 * np.cross([0, 0, 1.0], points - points.mean(axis=0))
    directions = similarity_directions(points)
    change = (turned - points).ravel()
    assert directions[:, 5] * 1e-7 == pytest.approx(-change, abs=1e-12) or directions[
        :, 5
    ] * 1e-7 == pytest.approx(change, abs=1e-12)


def test_a_step_that_leads_nowhere_is_not_taken():
    """Of an unknown that the observation hardly shows: infinitely far, as far as numbers go."""
    steps = []

    def update(values, step):
        steps.append(step)
        return values + step

    shown = 1e-120
    block = Block(
        name="one",
        observed=np.array([[1.0]]),
        covariance=np.ones((1, 1, 1)),
        index={"x": np.array([0])},
        evaluate=lambda values: (shown * values["x"], {"x": np.full((1, 1, 1), shown)}),
    )
    group = Group(name="x", values=np.zeros((1, 1)), update=update)
    solution = solve(Problem(groups=(group,), blocks=(block,)), iterations=2)
    assert not solution.converged
    assert all(np.abs(step).max() < 1e100 for step in steps)


def stations(lost=()):
    """Points seen from many stations, as vectors bent by a term, of which one value is held."""
    rng = np.random.default_rng(7)
    count, points = 60, rng.uniform(-5, 5, (9, 3))
    station, point = (grid.ravel() for grid in np.mgrid[:count, :9])
    seen = (rng.random(len(station)) < 0.6) & ~np.isin(station, lost)
    station, point = station[seen], point[seen]
    bend = rng.normal(size=(len(station), 3, 2))
    root = rng.normal(size=(len(station), 3, 3)) + 2.0 * np.eye(3)

    def evaluate(values):
        predicted = values["points"][point] - values["stations"][station]
        unit = np.broadcast_to(np.eye(3), (len(station), 3, 3))
        bent = np.einsum("mij,j->mi", bend, values["common"][0])
        return predicted + bent, {"common": bend, "stations": -unit, "points": unit}

    return Problem(
        groups=(
            Group(name="common", values=np.zeros((1, 2)), held=np.array([[False, True]])),
            Group(name="stations", values=np.zeros((count, 3))),
            Group(name="points", values=points),
        ),
        blocks=(
            Block(
                name="vectors", observed=rng.normal(size=(len(station), 3)),
                covariance=root @ np.swapaxes(root, 1, 2),
                index={"common": 0 * point, "stations": station, "points": point},
                evaluate=evaluate,
            ),
        ),
        datum={"points": rigid_directions(points)[:, :3]},
    )  # fmt: skip


def test_stations_that_are_eliminated_come_out_as_from_the_whole_equations():
    problem = stations()
    assert apart(problem) == (problem.slices()["stations"], 3)
    solution = solve(problem)
    at = linearise(problem, {group.name: group.values for group in problem.groups})
    free, datum = problem.free(), problem.datum_matrix()
    normal, datum = at.normal[np.ix_(free, free)], datum[free]
    bordered = np.block([[normal, datum], [datum.T, np.zeros((3, 3))]])
    wanted = np.linalg.inv(bordered)[: len(normal), : len(normal)]
    assert np.abs(solution.covariance[np.ix_(free, free)] - wanted).max() < 1e-10
    step = np.concatenate([(solution.values[g.name] - g.values).ravel() for g in problem.groups])
    assert np.abs(step[free] - wanted @ at.right[free]).max() < 1e-8


def test_a_station_that_nothing_was_seen_from_is_found_among_those_eliminated():
    solution = solve(stations(lost=(17,)))
    assert len(solution.undetermined) == 3
    assert all(d.labels[0].startswith("stations 17") for d in solution.undetermined)
