"""Programs that are led to parts which lie elsewhere, without images: what is seen is computed."""

import numpy as np
import pytest
from planning_cells import MACHINE, REAL, part, scene

from omm_core.geometry import RigidTransform, rotation_from_euler_xyz_rad
from omm_core.planning.guide import AS_PLANNED, CORRECTED, NOTHING_SEEN, Guide, GuidedStop
from omm_core.planning.plan import make_plan
from omm_core.planning.plan_program import TRIES_OF_A_SEARCH, look_from_afar
from omm_core.planning.sightings import PredictedSighting, predicted_sightings
from omm_core.planning.views import views
from omm_core.planning.wish import PlanWish


@pytest.fixture(scope="module")
def plan():
    return make_plan(scene(REAL, at=(600.0, 400.0, -50.0)), MACHINE, PlanWish())


def led(plan, true_scene, limit_mm, random):
    """Go through the program as LinuxCNC does; returns views of each target and images taken."""
    rows = {target.id: row for row, target in enumerate(plan.scene.part.targets)}
    stops = [GuidedStop(axes=s.axes, rows=tuple(rows[t] for t in s.target_ids)) for s in plan.stops]
    look = GuidedStop(axes=look_from_afar(plan, limit_mm), rows=stops[0].rows, look_mm=limit_mm)
    guide = Guide(scene=plan.scene, stops=[look, *stops], limit_mm=limit_mm)
    seen, images, shift = dict.fromkeys(rows, 0), 0, np.zeros(3)
    for number, stop in enumerate(guide.stops, start=1):
        for _ in range(TRIES_OF_A_SEARCH):
            images += 1
            limit = limit_mm + stop.look_mm  # as the program has it
            axes = {n: stop.axes[n] + s for n, s in zip("XYZ", np.clip(shift, -limit, limit))}
            spindle = plan.scene.kinematics.machine_T_spindle(axes)
            found = look_at(true_scene, spindle, random)
            correction = guide.after_image(number, spindle, found)
            shift = np.array(correction.shift_mm)
            for target in found if number > 1 else ():
                seen[target] += 1
            if correction.status != NOTHING_SEEN:
                break
    return seen, images


def look_at(true_scene, spindle, random):
    visible = np.flatnonzero(views(true_scene, [spindle]).visible[0])
    if not len(visible):
        return {}
    sightings = [
        PredictedSighting(
            machine_T_spindle=spindle, row=row, center_px=np.zeros(2), diameter_px=1.0
        )
        for row in visible
    ]
    pixels, diameters = predicted_sightings(true_scene, true_scene.gamma_s_rad, sightings)
    noisy = pixels + 0.01 * random.normal(size=pixels.shape)
    ids = [true_scene.part.targets[row].id for row in visible]
    return {i: (p, d) for i, p, d in zip(ids, noisy, diameters)}


def displaced(cell, shift_mm, turn_rad, gamma_s=0.002):
    middle = cell.targets_in_machine().mean(axis=0)
    R = rotation_from_euler_xyz_rad(*turn_rad)
    moved = RigidTransform(rotation=R, translation_mm=middle + shift_mm - R @ middle)
    there = cell.elsewhere(moved @ cell.machine_T_part)
    return type(there)(**{**there.__dict__, "gamma_s_rad": gamma_s})


@pytest.mark.parametrize("seed", range(8))
def test_a_part_200_mm_and_2_degrees_away_is_seen_as_planned(plan, seed):
    random = np.random.default_rng(seed)
    shift = random.choice([-1.0, 1.0], 3) * [200.0, 200.0, 100.0] * random.uniform(0.8, 1.0, 3)
    turn = np.deg2rad(random.uniform(-2.0, 2.0, 3))
    seen, images = led(plan, displaced(plan.scene, shift / 1.3, turn), 200.0, random)
    assert min(seen.values()) >= 2
    assert images < 40


def test_a_part_that_lies_as_planned_is_measured_as_planned(plan):
    random = np.random.default_rng(1)
    seen, images = led(plan, displaced(plan.scene, np.zeros(3), np.zeros(3)), 200.0, random)
    assert images == len(plan.stops) + 1
    assert set(seen.values()) == {2}


def test_one_image_already_tells_where_its_target_is(plan):
    cell = displaced(plan.scene, np.array([40.0, -30.0, 20.0]), np.zeros(3))
    random = np.random.default_rng(2)
    row = plan.scene.part.targets.index(plan.scene.part.target(plan.stops[0].target_ids[0]))
    guide = Guide(
        scene=plan.scene, stops=[GuidedStop(axes=s.axes, rows=(row,)) for s in plan.stops[:2]],
        limit_mm=100.0,
    )  # fmt: skip
    spindle = plan.scene.kinematics.machine_T_spindle(
        {n: v + d for (n, v), d in zip(plan.stops[0].axes.items(), (40.0, -30.0, 20.0))}
    )
    correction = guide.after_image(1, spindle, look_at(cell, spindle, random))
    assert correction.status == CORRECTED
    assert np.allclose(correction.shift_mm, (40.0, -30.0, 20.0), atol=3.0)


def test_where_nothing_is_seen_the_search_goes_from_near_to_far_and_never_beyond_the_limit(plan):
    guide = Guide(
        scene=plan.scene, stops=[GuidedStop(axes=plan.stops[0].axes, rows=(0,))], limit_mm=60.0
    )
    spindle = plan.stops[0].machine_T_spindle
    shifts = [guide.after_image(1, spindle, {}) for _ in range(6)]
    assert {c.status for c in shifts} == {NOTHING_SEEN}
    assert len({c.shift_mm for c in shifts}) > 3
    assert np.abs([c.shift_mm for c in shifts]).max() <= 60.0


def test_targets_of_other_parts_are_nothing_seen(plan):
    guide = Guide(
        scene=plan.scene, stops=[GuidedStop(axes=plan.stops[0].axes, rows=(0,))], limit_mm=60.0
    )
    other = {99: (np.array([1000.0, 900.0]), 80.0)}
    assert guide.after_image(1, plan.stops[0].machine_T_spindle, other).status == NOTHING_SEEN


def test_a_program_that_begins_anew_is_led_anew(plan):
    cell = displaced(plan.scene, np.array([5.0, 0.0, 0.0]), np.zeros(3), gamma_s=0.0)
    rows = {target.id: row for row, target in enumerate(plan.scene.part.targets)}
    stops = [GuidedStop(axes=s.axes, rows=tuple(rows[t] for t in s.target_ids)) for s in plan.stops]
    guide = Guide(scene=plan.scene, stops=stops, limit_mm=60.0)
    spindle = plan.stops[0].machine_T_spindle
    random = np.random.default_rng(0)
    assert guide.after_image(1, spindle, look_at(cell, spindle, random)).status == CORRECTED
    guide.reset()
    as_planned = plan.scene.elsewhere(plan.scene.machine_T_part)
    found = look_at(as_planned, spindle, random)
    assert guide.after_image(1, spindle, found).status == AS_PLANNED


def test_parts_without_normals_are_led_by_directions_alone():
    bare = part()
    targets = tuple(type(t)(**{**t.__dict__, "normal": None}) for t in bare.targets[:2])
    cell = scene(part=type(bare)(**{**bare.__dict__, "targets": targets}))
    sighting = PredictedSighting(
        machine_T_spindle=cell.kinematics.machine_T_spindle({"X": 100.0, "Y": 100.0, "Z": 520.0}),
        row=0, center_px=np.zeros(2), diameter_px=70.0,
    )  # fmt: skip
    pixels, diameters = predicted_sightings(cell, 0.0, [sighting])
    assert np.isfinite(pixels).all()
    assert diameters.tolist() == [70.0]
