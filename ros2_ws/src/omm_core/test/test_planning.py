"""Every stop of a plan is possible; the plan reaches what was wished, or says what would help."""

from dataclasses import replace

import numpy as np
import pytest
from planned_runs import normalised_squares
from planning_cells import EXACT, MACHINE, REAL, camera, kinematics, part, scene

from omm_core.errors import MeasurementError
from omm_core.geometry import RigidTransform
from omm_core.imaging.circle import circle_points
from omm_core.imaging.taking import Body, Imaging
from omm_core.planning.collision import CLEARANCE_MM, clearance_mm
from omm_core.planning.plan import make_plan
from omm_core.planning.timing import Pace
from omm_core.planning.wish import PlanWish, smallest_bumps_mm

CAMERA = camera(
    Imaging(exposure_s=0.01, focus_mm=(250.0, 400.0), max_tilt_rad=0.5),
    Body(radius_mm=60.0, z_mm=(-330.0, 0.0)),
)
TIGHT = kinematics(((0.0, 1900.0), (0.0, 1300.0), (300.0, 900.0)))


@pytest.fixture(scope="module")
def plan():
    cell = scene(calibration=CAMERA, kinematics=TIGHT, at=(150.0, 120.0, 100.0))
    return make_plan(cell, MACHINE, PlanWish(place_mm=0.05, angle_mm_per_m=0.05))


def in_camera(plan, stop):
    """Targets in the camera's frame, (T, 3), by plain transforms."""
    camera_T_part = (
        stop.machine_T_spindle @ plan.scene.calibration.taper_T_camera
    ).inverse() @ plan.scene.machine_T_part
    return camera_T_part, {t.id: camera_T_part @ t.xyz_mm for t in plan.scene.part.targets}


def test_every_target_is_seen_twice_and_the_wish_is_reached(plan):
    times = {t.id: sum(t.id in s.target_ids for s in plan.stops) for t in plan.scene.part.targets}
    assert min(times.values()) >= 2
    assert plan.reached
    assert plan.expanded_uncertainty[3:6].max() <= 0.05
    assert 1e3 * plan.expanded_uncertainty[:3].max() <= 0.05


def test_no_axis_is_over_its_limit_and_the_axes_make_the_pose(plan):
    for stop in plan.stops:
        assert TIGHT.out_of_limits(stop.axes) == ()
        pose = TIGHT.machine_T_spindle(stop.axes)
        assert np.allclose(pose.translation_mm, stop.machine_T_spindle.translation_mm, atol=1e-9)
        assert all(round(v, 3) == v for v in stop.axes.values())


def test_targets_are_whole_in_the_image_in_focus_and_not_too_slanted(plan):
    for stop in plan.stops:
        camera_T_part, places = in_camera(plan, stop)
        for target in plan.scene.part.targets:
            if target.id not in stop.target_ids:
                continue
            place, normal = places[target.id], camera_T_part.rotation @ target.normal
            assert 250.0 <= place[2] <= 400.0
            assert np.arccos(-place @ normal / np.linalg.norm(place)) <= 0.5
            ring = circle_points(place[None], normal[None], [3.5 * 8.0])[0]
            pixels = CAMERA.lens.project(ring)
            assert np.all((pixels > 0) & (pixels < [CAMERA.width_px - 1, CAMERA.height_px - 1]))


def test_the_body_keeps_clear_of_a_box_higher_than_its_targets():
    tall = replace(part(), box_mm=np.array([[0.0, 0.0, -50.0], [1500.0, 1000.0, 500.0]]))
    # Straight in front a target would be in focus where the camera stood in the box.
    made = make_plan(
        scene(part=tall, calibration=replace(CAMERA, imaging=Imaging())), MACHINE, PlanWish()
    )
    body = CAMERA.body
    around = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    rim = np.column_stack([np.cos(around), np.sin(around)]) * body.radius_mm
    for stop in made.stops:
        part_T_spindle = made.scene.machine_T_part.inverse() @ stop.machine_T_spindle
        for z in np.linspace(*body.z_mm, 12):
            for share in (0.0, 0.5, 1.0):
                points = part_T_spindle @ np.column_stack([share * rim, np.full(24, z)])
                outside = points - np.clip(points, *tall.box_mm)
                assert np.linalg.norm(outside, axis=1).min() >= CLEARANCE_MM - 0.1


def test_clearance_is_the_distance_of_cylinder_and_box():
    boxed = replace(part(), box_mm=np.array([[0.0, 0.0, 0.0], [100.0, 100.0, 100.0]]))
    cell = scene(part=boxed, calibration=CAMERA, at=(0.0, 0.0, 0.0))
    places = {
        (50.0, 50.0, 500.0): 500.0 - 330.0 - 100.0,  # above: the cylinder's lower end
        (250.0, 50.0, 200.0): 250.0 - 60.0 - 100.0,  # beside: its side
        (50.0, 50.0, 300.0): 0.0,  # inside
        (260.0, 260.0, 200.0): np.hypot(160.0, 160.0) - 60.0,  # across the box's edge
    }
    spindles = [RigidTransform(rotation=np.eye(3), translation_mm=np.array(p)) for p in places]
    assert clearance_mm(cell, spindles) == pytest.approx(list(places.values()), abs=0.1)


def test_where_only_images_are_noisy_more_of_them_are_taken_until_the_wish_is_reached():
    cell = scene(EXACT, part=part(sigma_mm=0.0))
    loose = make_plan(cell, MACHINE, PlanWish())
    wanted = 0.75 * float(loose.corner_U_mm.max())
    made = make_plan(cell, MACHINE, PlanWish(point_mm=wanted))
    assert made.reached
    assert made.corner_U_mm.max() <= wanted
    assert len(made.stops) > len(loose.stops)
    assert any("Twice the images would lower U" in f for f in loose.findings)


def test_where_images_cannot_help_more_or_better_targets_are_named():
    made = make_plan(scene(), MACHINE, PlanWish(place_mm=0.01, angle_mm_per_m=0.01))
    assert not made.reached
    assert "not reached" in made.findings[0]
    assert "More or better targets" in made.findings[0]
    assert any(f.startswith("More images buy nothing") for f in made.findings)
    assert len(made.stops) >= 8


def test_a_bump_that_is_wanted_is_noticed_or_the_plan_says_which_targets_hide_it():
    cell = scene()
    can = make_plan(cell, MACHINE, PlanWish(bump_mm=0.35))
    assert can.reached
    assert max(can.bumps_mm.values()) <= 0.35
    cannot = make_plan(cell, MACHINE, PlanWish(bump_mm=0.05))
    assert not cannot.reached
    assert "bump of target" in cannot.findings[0]


def test_a_bump_of_the_smallest_size_is_as_far_off_as_the_test_needs(plan):
    """Twice as exact everything: bumps of half the size are noticed (but for the threshold)."""
    from omm_core.planning.prediction import designs
    from omm_core.planning.views import views

    spindles = [s.machine_T_spindle for s in plan.stops]
    every = np.arange(len(spindles))
    sizes = []
    for factor in (1.0, 0.5):
        cell = scene(
            replace(REAL, image_sigma_px=0.005 * factor, stop_sigma_mm=0.003 * factor,
                    geometry_sigma_mm=0.015 * factor),
            part=part(sigma_mm=0.02 * factor), calibration=CAMERA, kinematics=TIGHT,
            at=(150.0, 120.0, 100.0), play_mm=0.0,
        )  # fmt: skip
        made = designs(cell, spindles, views(cell, spindles))
        sizes.append(max(smallest_bumps_mm(made, cell.noise, every).values()))
    assert 0.5 < sizes[1] / sizes[0] < 0.6


@pytest.mark.parametrize(
    "places", [((0.0, 0.0),), ((0, 0), (900, 0)), ((0, 0), (500, 0), (900, 0))]
)
def test_targets_that_determine_no_pose_are_no_plan(places):
    flat = part(places)
    flat = replace(
        flat, targets=tuple(replace(t, xyz_mm=t.xyz_mm * [1, 1, 0]) for t in flat.targets)
    )
    made = make_plan(scene(part=flat), MACHINE, PlanWish())
    assert not made.reached
    assert "not determined" in made.findings[0]


def test_a_part_out_of_reach_is_told_with_its_reason():
    with pytest.raises(MeasurementError, match="axis X would be over its limit"):
        make_plan(scene(at=(9000.0, 0.0, 0.0)), MACHINE, PlanWish())


def test_what_is_not_told_and_rests_on_belief_is_told():
    bare = part()
    bare = replace(bare, targets=tuple(replace(t, sigma_xyz_mm=None) for t in bare.targets))
    told = " ".join(make_plan(scene(part=bare), MACHINE, PlanWish()).findings)
    for words in (
        "no focus",
        "no max_tilt_rad",
        "no body",
        "no box_mm",
        "taken as exact",
        "slow machine",
    ):
        assert words in told


def test_measurements_by_a_plan_show_the_predicted_covariance(plan):
    """Full solver, declared machine: mean normalised squared error 7 within four of its sigma."""
    squares = normalised_squares(plan, runs=60, seed=11)
    assert np.mean(squares) == pytest.approx(7.0, abs=4.0 * np.sqrt(14.0 / 60))


def test_the_pace_is_that_of_the_slowest_axis():
    pace = Pace.of(MACHINE, kinematics())
    origin, far = dict.fromkeys("XYZ", 0.0), {"X": 1500.0, "Y": 0.0, "Z": 0.0}
    assert pace.move_s(origin, origin) == 0.0
    # Long moves: the way over the speed, and one ramp up and down of v/a + a/j.
    assert pace.move_s(origin, far) == pytest.approx(1500 / 150 + 150 / 1000 + 1000 / 10000)
    assert pace.move_s(origin, {**far, "Y": 10.0}) == pytest.approx(
        pace.move_s(origin, far), rel=1e-3
    )
