"""Least machine time: the wish is kept, each target seen twice, nothing quicker overlooked."""

import itertools

import numpy as np
import pytest
from planning_cells import MACHINE, REAL, camera, kinematics, part, scene

from omm_core.imaging.taking import Body, Imaging
from omm_core.planning.candidates import find_candidates, rotary_positions
from omm_core.planning.choosing import Pool, cover_twice, exchange
from omm_core.planning.plan import make_plan
from omm_core.planning.prediction import designs
from omm_core.planning.quickest import quickest
from omm_core.planning.timing import Pace, rest_to_rest_s
from omm_core.planning.wish import PlanWish, Yardstick

SMALL = tuple((40.0 * (i % 4), 40.0 * (i // 4)) for i in range(8))


def pool_of(cell, candidates, wish):  # type: ignore[no-untyped-def]
    return Pool(
        designs=designs(cell, candidates.spindles, candidates.views),
        visible=candidates.views.visible,
        margin_mm=candidates.views.margin_mm,
        noise=cell.noise,
        yardstick=Yardstick.of(cell, wish),
    )


@pytest.mark.parametrize("wish", [{"point_mm": 0.05}, {"point_mm": 0.06, "bump_mm": 0.35}])
def test_less_time_than_the_fewest_images_and_the_wish_is_kept(wish) -> None:  # type: ignore[no-untyped-def]
    fewest = make_plan(scene(REAL), MACHINE, PlanWish(**wish))
    quick = make_plan(scene(REAL), MACHINE, PlanWish(**wish, least_time=True))
    assert quick.reached
    assert quick.seconds < fewest.seconds - 1.0
    assert quick.corner_U_mm.max() <= wish["point_mm"]
    assert max(quick.bumps_mm.values()) <= wish.get("bump_mm", np.inf)
    seen = [target for stop in quick.stops for target in stop.target_ids]
    assert all(seen.count(target.id) >= 2 for target in quick.scene.part.targets)
    kinematics = quick.scene.kinematics
    assert not any(kinematics.out_of_limits(stop.axes) for stop in quick.stops)


def test_what_cannot_be_reached_is_left_as_it_is() -> None:
    wish = {"point_mm": 0.001}
    best = make_plan(scene(REAL), MACHINE, PlanWish(**wish))
    quick = make_plan(scene(REAL), MACHINE, PlanWish(**wish, least_time=True))
    assert not quick.reached
    assert quick.corner_U_mm.max() == pytest.approx(best.corner_U_mm.max(), rel=0.1)


def test_of_all_pairs_of_stops_it_finds_one_of_the_quickest() -> None:
    cell = scene(REAL, part=part(SMALL, 0.005), at=(300, 300, 0))
    wish = PlanWish(point_mm=0.05, least_time=True)
    candidates, _ = find_candidates(cell, rotary_positions(cell)[:1])
    pool = pool_of(cell, candidates, wish)
    pace = Pace.of(MACHINE, cell.kinematics)
    chosen = quickest(cell, pace, candidates, pool, exchange(pool, cover_twice(pool)))
    assert len(chosen) == 2
    whole = np.flatnonzero(pool.visible.all(axis=1))
    pairs = np.array(list(itertools.combinations(whole.tolist(), 2)))
    good = pairs[pool.reached_by_U(pairs)]
    axes = np.array([[stop[n] for n in pace.limits] for stop in candidates.axes])
    times = pace.moves_s(axes[good[:, 0]], axes[good[:, 1]])
    found = float(pace.moves_s(axes[chosen[0]], axes[chosen[1]]))
    assert pool.reached_by_U(chosen[None])[0]
    # One stop changes at a time: the pair of all pairs need not be met, but nearly.
    assert found <= np.quantile(times, 0.01)
    assert found <= 1.3 * times.min()


def test_times_of_many_moves_are_those_of_each() -> None:
    pace = Pace.of(MACHINE, scene(REAL).kinematics)
    random = np.random.default_rng(1)
    here, there = random.uniform(0, 1000, (2, 20, 3))
    there[3] = here[3]
    there[4, 1:] = here[4, 1:]
    each = [pace.move_s(dict(zip("XYZ", a)), dict(zip("XYZ", b))) for a, b in zip(here, there)]
    assert pace.moves_s(here, there) == pytest.approx(each)
    assert each[3] == 0.0
    # 200 mm, 100 mm/s, 50 mm/s²: 2 s up, 2 s down, nothing between; no jerk to speak of.
    assert rest_to_rest_s(200.0, 100.0, 50.0, 1e9) == pytest.approx(4.0, rel=1e-3)


def test_a_camera_that_would_meet_a_part_that_lies_higher_is_told() -> None:
    box = np.array([[-50.0, -50.0, -100.0], [1550.0, 1050.0, 20.0]])
    body = Body(radius_mm=40.0, z_mm=(-330.0, 0.0))
    # In focus from 60 to 85 mm: the body, 10 mm longer than the camera, is that near.
    eye = camera(Imaging(focus_mm=(60.0, 85.0)), body)
    plan = make_plan(scene(REAL, part=part(box_mm=box), calibration=eye), MACHINE, PlanWish())
    by_words = {place.words: place.clearance_mm for place in plan.elsewhere}
    assert by_words["z +50 mm"] == 0.0
    assert by_words["z -50 mm"] > 50.0
    told = [words for words in plan.findings if "the camera would meet its box" in words]
    assert "z +50 mm" in told[0]
    free = make_plan(scene(REAL), MACHINE, PlanWish())
    assert not [words for words in free.findings if "would meet" in words]


def test_a_part_larger_than_the_machine_is_told_with_the_axis_and_no_more() -> None:
    short = kinematics(((-1000.0, 700.0), (-1000.0, 2000.0), (-500.0, 1500.0)))
    plan = make_plan(scene(REAL, kinematics=short), MACHINE, PlanWish(point_mm=0.05))
    assert not plan.reached
    assert "seen can be 2 of 4" in plan.findings[0]
    assert "axis X would be over its limit" in plan.findings[0]
    # What more images or another place would do means nothing where nothing is determined.
    assert not [w for w in plan.findings if "images" in w.lower() or "views are lost" in w]
    # Room about the targets is given up only where that shows more of them.
    assert plan.scene.play_mm == 10.0
