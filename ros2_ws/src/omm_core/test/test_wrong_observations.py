"""What is wrong is found, named and left out, or refused where nobody can tell."""

import re
from dataclasses import replace

import numpy as np
import pytest
from core_cells import EXACT_MACHINE, bench_cell, random_cell

from omm_core.part_pose import SolveOptions, solve

SIGMA_PX = 0.05


@pytest.fixture
def cell():
    return bench_cell(np.random.default_rng(21))


@pytest.fixture
def good(cell):
    return list(cell.noisy(np.random.default_rng(22), SIGMA_PX))


def assert_solved(cell, solution, used):
    assert solution.determined, solution.missing
    assert solution.used.sum() == used
    sigma = np.sqrt(np.diag(solution.covariance))
    assert np.all(np.abs(solution.theta - cell.theta) < 4 * sigma)


def _number(observations, index):
    stamps = sorted({o.stamp_ns for o in observations})
    ns = observations[index].stamp_ns
    return f"{stamps.index(ns) + 1} of {len(stamps)} ({ns} ns)"


def moved(observation, col, row):
    return replace(observation, center_px=observation.center_px + np.array([col, row]))


def test_nothing_is_found_wrong_with_good_observations(cell, good):
    solution = solve(good, cell.part, cell.calibration)
    assert_solved(cell, solution, used=8)
    assert solution.findings == ()


def test_good_observations_are_left_out_no_more_often_than_the_significance_says(cell):
    """α = 0.001 each for the global and the single tests: of 400 runs, 0 or 1 expected."""
    random = np.random.default_rng(1)
    wrong = sum(
        solve(cell.noisy(random, SIGMA_PX), cell.part, cell.calibration).used.sum() < 8
        for _ in range(400)
    )
    assert wrong <= 4


@pytest.mark.parametrize("index", range(8))
def test_a_centre_pulled_by_a_reflection_is_found_in_any_image(cell, good, index):
    good[index] = moved(good[index], 1.0, -0.8)
    solution = solve(good, cell.part, cell.calibration)
    assert_solved(cell, solution, used=7)
    assert not solution.used[index]
    (words,) = solution.findings
    assert f"target {good[index].target_id} in image {_number(good, index)}" in words


@pytest.mark.parametrize("target_id", [42, 40, 8, 122])
def test_a_bumped_target_is_named_with_how_far_it_went(cell, good, target_id):
    bump = np.array([0.8, -0.6, 0.0])
    targets = tuple(
        replace(t, xyz_mm=t.xyz_mm - bump) if t.id == target_id else t for t in cell.part.targets
    )
    solution = solve(good, replace(cell.part, targets=targets), cell.calibration)
    assert solution.used.sum() == 6
    (words,) = solution.findings
    distance = re.match(rf"target {target_id} is ([\d.]+) mm from", words)
    assert float(distance[1]) == pytest.approx(1.0, abs=0.1)
    assert "was it bumped?" in words


def test_a_misread_identifier_is_named_with_what_it_should_be(cell, good):
    good[2] = replace(good[2], target_id=122)
    solution = solve(good, cell.part, cell.calibration)
    assert_solved(cell, solution, used=7)
    assert "target 40 was read as 122" in solution.findings[0]


def test_the_pose_of_another_image_is_named(cell, good):
    good[5] = replace(good[5], machine_T_spindle=good[4].machine_T_spindle)
    solution = solve(good, cell.part, cell.calibration)
    assert_solved(cell, solution, used=7)
    assert f"it is that of image {_number(good, 4)}" in solution.findings[0]


def test_a_stale_image_is_named(cell, good):
    """The camera delivers what it saw at the image before: centre and target of that one."""
    good[5] = replace(moved(good[4], 0.03, -0.02), stamp_ns=good[5].stamp_ns,
                      machine_T_spindle=good[5].machine_T_spindle)  # fmt: skip
    solution = solve(good, cell.part, cell.calibration)
    assert_solved(cell, solution, used=7)
    assert f"fits the pose of image {_number(good, 4)}" in solution.findings[0]


def test_mirrored_images_are_refused_with_the_reason(cell, good):
    mirrored = [
        replace(o, center_px=np.array([2591.0 - o.center_px[0], o.center_px[1]])) for o in good
    ]
    solution = solve(mirrored, cell.part, cell.calibration)
    assert not solution.determined
    assert "mirrored left to right" in solution.missing[0]
    assert np.isnan(solution.theta).all()


def test_where_nobody_can_tell_which_is_wrong_nothing_is_published(cell, good):
    """Four images of three targets: one degree of freedom tells that, but not which."""
    few = [good[0], good[1], good[2], good[4]]
    few[1] = moved(few[1], 25.0, 10.0)
    solution = solve(few, cell.part, cell.calibration)
    assert not solution.determined
    assert "too few to tell which is wrong" in solution.missing[0]


def test_two_wrong_images_of_sixteen_are_found_one_after_the_other():
    cell = bench_cell(np.random.default_rng(3), images_per_target=4)
    good = list(cell.noisy(np.random.default_rng(4), SIGMA_PX))
    good[3], good[9] = moved(good[3], 4.0, 0.0), moved(good[9], 0.0, -7.0)
    solution = solve(good, cell.part, cell.calibration)
    assert_solved(cell, solution, used=14)
    assert len(solution.findings) == 2


def test_all_targets_of_one_image_with_a_wrong_pose_are_left_out_together():
    random = np.random.default_rng(12)
    cell = random_cell(random)
    while max(np.bincount([o.stamp_ns // 10**9 for o in cell.observations])) < 3:
        cell = random_cell(random)
    good = list(cell.noisy(random, SIGMA_PX))
    counts = np.bincount([o.stamp_ns // 10**9 for o in good])
    stamp = int(np.argmax(counts)) * 10**9
    pose = next(o.machine_T_spindle for o in good if o.stamp_ns == stamp)
    shifted = replace(pose, translation_mm=pose.translation_mm + np.array([2.0, 1.0, 0.0]))
    bad = [replace(o, machine_T_spindle=shifted) if o.stamp_ns == stamp else o for o in good]
    solution = solve(bad, cell.part, cell.calibration)
    assert_solved(cell, solution, used=len(good) - counts.max())
    assert "spindle pose is wrong" in solution.findings[0]


def test_centres_that_are_all_worse_than_they_say_are_taken_for_noise(cell):
    """The machine may err by that: nothing is refused, U is as much larger, and it is said."""
    random = np.random.default_rng(5)
    noisy = [
        replace(o, center_px=o.center_px + random.normal(0, 10 * SIGMA_PX, 2))
        for o in cell.noisy(random, SIGMA_PX)
    ]
    solution = solve(noisy, cell.part, cell.calibration)
    exact = SolveOptions(find_errors=False, **EXACT_MACHINE)
    ideal = solve(cell.noisy(random, SIGMA_PX), cell.part, cell.calibration, exact)
    assert solution.determined
    assert solution.used.all()
    ratio = solution.expanded_uncertainty / ideal.expanded_uncertainty
    assert np.all((ratio > 3.0) & (ratio < 20.0))
    assert solution.machine.stop_sigma_mm.median > 0.01
    assert solution.remarks[0].startswith("the machine's errors: stops")


def test_a_machine_declared_too_exact_is_told_and_u_enlarged(cell):
    random = np.random.default_rng(5)
    noisy = [
        replace(o, center_px=o.center_px + random.normal(0, 10 * SIGMA_PX, 2))
        for o in cell.noisy(random, SIGMA_PX)
    ]
    solution = solve(noisy, cell.part, cell.calibration, SolveOptions(**EXACT_MACHINE))
    assert solution.used.all()
    assert 5.0 < np.sqrt(solution.covariance_factor) < 20.0
    (words,) = solution.findings
    assert "not as exact as its file declares" in words


def test_a_part_file_of_another_part_is_refused_not_averaged(cell, good):
    targets = tuple(replace(t, xyz_mm=t.xyz_mm * [1.1, 0.95, 1.0]) for t in cell.part.targets)
    solution = solve(good, replace(cell.part, targets=targets), cell.calibration)
    assert not solution.determined
    assert "part file" in solution.missing[0]


def test_the_search_can_be_switched_off(cell, good):
    good[3] = moved(good[3], 1.0, -0.8)
    options = SolveOptions(find_errors=False)
    solution = solve(good, cell.part, cell.calibration, options)
    assert solution.used.all()
    assert solution.findings == ()


# --- on a machine of unknown noise --------------------------------------------------------------


@pytest.mark.parametrize(("stop_um", "geometry_um"), [(3, 0), (8, 0), (8, 15)])
def test_a_target_bumped_by_half_a_millimetre_is_named_on_a_machine_that_errs(stop_um, geometry_um):
    from test_machine_noise import erring

    cell = bench_cell(np.random.default_rng(21))
    random = np.random.default_rng(stop_um + 100 * geometry_um)
    named = 0
    for target in cell.part.targets:
        seen, _ = erring(cell, random, stop_um / 1e3, geometry_um / 1e3)
        bump = random.normal(size=3)
        bump *= 0.5 / np.linalg.norm(bump)
        targets = tuple(
            replace(t, xyz_mm=t.xyz_mm - bump) if t.id == target.id else t
            for t in cell.part.targets
        )
        solution = solve(seen, replace(cell.part, targets=targets), cell.calibration)
        told = (*solution.findings, *solution.missing)
        named += any(f"target {target.id} is " in words for words in told)
    assert named == len(cell.part.targets)


def test_clean_runs_on_machines_that_err_lose_nothing():
    from test_machine_noise import erring

    cell = bench_cell(np.random.default_rng(21))
    random = np.random.default_rng(77)
    for number in range(40):
        stop_um, geometry_um = (1, 3, 8)[number % 3], (0, 15, 40)[number // 3 % 3]
        seen, _ = erring(cell, random, stop_um / 1e3, geometry_um / 1e3)
        solution = solve(seen, cell.part, cell.calibration)
        assert solution.determined
        assert solution.used.all(), solution.findings


def test_what_cannot_be_left_out_is_named_and_nothing_published(cell, good):
    """Of three targets with two images each, one bumped: without it two are left."""
    three = [o for o in good if o.target_id != 122]
    bump = np.array([0.8, -0.6, 0.9])
    targets = tuple(
        replace(t, xyz_mm=t.xyz_mm - bump) if t.id == 8 else t for t in cell.part.targets
    )
    solution = solve(three, replace(cell.part, targets=targets), cell.calibration)
    assert not solution.determined
    assert np.isnan(solution.theta).all()
    assert "target" in solution.missing[0]


def test_errors_beyond_any_machine_are_refused_and_the_limit_is_said(cell):
    from test_machine_noise import erring

    seen, _ = erring(cell, np.random.default_rng(4), stop_mm=0.15)
    solution = solve(seen, cell.part, cell.calibration)
    assert not solution.determined
    assert any("worst_machine_mm" in w or "cannot" in w or "too few" in w for w in solution.missing)
    wide = SolveOptions(worst_machine_mm=1.0)
    assert solve(seen, cell.part, cell.calibration, wide).determined
