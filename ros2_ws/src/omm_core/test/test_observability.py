"""What is not determined is said in words, and not published."""

from dataclasses import replace

import numpy as np
from core_cells import BACKLASH_RAD, PAPER_CALIBRATION, bench_cell, observe, spindle_at_bench

from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform
from omm_core.part_pose import SolveOptions, solve

SIGMA_PX = 0.05


def bench(offsets_mm, seed=1, targets=(0, 1, 2, 3), xyz=None):
    """Return a bench cell's truth and the noisy observations from places beside each target."""
    random = np.random.default_rng(seed)
    cell = bench_cell(random)
    part = cell.part
    if xyz is not None:
        part = replace(
            part, targets=tuple(replace(t, xyz_mm=np.array(x)) for t, x in zip(part.targets, xyz))
        )
    spindles = [
        spindle_at_bench(cell.machine_T_part @ part.targets[t].xyz_mm + np.array([*o, 0.0]))
        for t in targets
        for o in offsets_mm
    ]
    seen = observe(part, cell.calibration, cell.machine_T_part, cell.gamma_s_rad, spindles)
    noisy = [
        replace(
            o,
            center_px=o.center_px + random.normal(0, SIGMA_PX, 2),
            covariance_px2=np.eye(2) * SIGMA_PX**2,
        )
        for o in seen
    ]
    return noisy, part, cell


def words(observations, part, **options):
    solution = solve(observations, part, PAPER_CALIBRATION, SolveOptions(**options))
    assert not solution.determined
    assert np.isnan(solution.theta).all()
    assert np.isnan(solution.covariance).all()
    return solution.missing[0]


def test_each_target_from_the_same_place_beside_it_does_not_tell_gamma_s():
    """γ_s and a shift of the part are the same then; a second image tells them apart."""
    once, part, cell = bench([(0.0, 0.0)])
    told = words(once, part)
    assert told.startswith("γ_s (and with it")
    assert "every target was seen from one spindle position only" in told
    assert "take a second image of target" in told
    assert "at least 40 mm away" in told
    # Doing what it says helps.
    target_id = int(told.split("image of target ")[1].split()[0])
    more = bench([(40.0, 0.0)], targets=[[t.id for t in part.targets].index(target_id)])[0]
    both = [*once, *(replace(o, stamp_ns=o.stamp_ns + 10**12) for o in more)]
    solution = solve(both, part, PAPER_CALIBRATION)
    assert solution.determined
    assert abs(solution.theta[6] - cell.gamma_s_rad) < 4 * np.sqrt(solution.covariance[6, 6])


def test_two_images_from_the_same_place_do_not_tell_gamma_s_either():
    twice, part, _ = bench([(0.0, 0.0), (1.0, 0.0)])
    told = words(twice, part)
    assert "at most 1.0 mm apart" in told
    assert "at least 40 mm away" in told


def one_image_each():
    """Each target once, but from different places beside it."""
    both, part, cell = bench([(-60.0, 0.0), (60.0, 10.0)])
    return [both[0], both[3], both[4], both[7]], part, cell


def test_with_gamma_s_given_one_image_of_each_target_determines_the_rest():
    once, part, cell = one_image_each()
    solution = solve(
        once, part, PAPER_CALIBRATION, SolveOptions(model="6d", gamma_s_rad=cell.gamma_s_rad)
    )
    assert solution.determined


def test_two_targets_are_too_few():
    few, part, _ = bench([(-60.0, 0.0), (60.0, 0.0)], targets=(0, 2))
    told = words(few, part)
    assert "only targets 8 and 42 were seen" in told
    assert "take an image of target 40 or 122" in told


def test_targets_on_a_line_leave_the_turn_about_it():
    xyz = [[0, 0, 0], [750, 0, 0], [1500, 0, 0], [0, 1000, 0]]
    line, part, _ = bench([(-60.0, 0.0), (60.0, 0.0)], targets=(0, 1, 2), xyz=xyz)
    told = words(line, part)
    assert "the turn about the line through 8, 40 and 42 (α)" in told
    assert "take an image of target 122" in told


def test_nothing_seen_yet():
    assert "no target of the part was seen yet" in words([], bench([(0.0, 0.0)])[1])


def test_a_part_with_two_targets_can_never_be_solved():
    part = Part(
        name="two",
        target_family="metashape12",
        targets=tuple(
            Target(id=i, xyz_mm=np.array([100.0 * i, 0, 0]), dot_diameter_mm=8.0) for i in (1, 2)
        ),
    )
    assert "the part file has 2 targets; at least 3 are needed" in words([], part)


def test_three_images_of_three_targets_are_one_too_few_for_7_unknowns():
    few, part, _ = bench([(0.0, 0.0)], targets=(0, 1, 2))
    assert "6 coordinates were measured for 7 unknowns; take at least 1 more" in words(few, part)


def test_a_flat_part_far_away_in_one_image_allows_two_poses():
    """The two-fold ambiguity of a plane seen from afar is told, not decided by chance."""
    random = np.random.default_rng(3)
    xyz = np.array([[-60.0, -40, 0], [60, -40, 0], [60, 40, 0], [-60, 40, 0]])
    part = Part(
        name="flat",
        target_family="metashape12",
        targets=tuple(
            Target(id=i + 1, xyz_mm=x, dot_diameter_mm=8.0, normal=np.array([0, 0, 1.0]))
            for i, x in enumerate(xyz)
        ),
    )
    pose = RigidTransform.from_euler_xyz_rad(0.25, 0.1, 0.0, (0.0, 0.0, 0.0))
    spindle = spindle_at_bench(np.array([-15.0, -35.0, 0.0]), distance_mm=2500.0)
    seen = observe(part, PAPER_CALIBRATION, pose, 0.0, [spindle], sigma_px=0.2)
    noisy = [replace(o, center_px=o.center_px + random.normal(0, 0.2, 2)) for o in seen]
    assert len(noisy) == 4
    told = words(noisy, part, model="6d")
    assert "two poses" in told or "known to" in told


def test_what_is_determined_poorly_is_said_but_published():
    once, part, _ = one_image_each()
    blurred = [replace(o, covariance_px2=1600 * o.covariance_px2) for o in once]
    solution = solve(blurred, part, PAPER_CALIBRATION)
    assert solution.determined
    (poor,) = solution.poor
    assert poor.startswith("γ_s")
    assert "every target was seen from one spindle position only" in poor
    assert np.sqrt(solution.covariance[6, 6]) < BACKLASH_RAD
