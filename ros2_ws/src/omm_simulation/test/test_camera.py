"""Laws of the rendered images, against closed forms and against omm_core's own model."""

import dataclasses

import cv2
import numpy as np
import pytest

from omm_core.geometry import RigidTransform, spindle_T_taper
from omm_core.targets.coded.families import smallest_rotation
from omm_simulation.camera import SimulatedCamera
from omm_simulation.cell import draw
from omm_simulation.rays import lens_numbers, see_plane
from omm_simulation.scenario import load_scenario
from omm_simulation.scene import REFLECTION_GAP_MM, scene_of

MS = 1_000_000


def changed(cell, **imaging):
    scenario = cell.scenario
    new = dataclasses.replace(scenario.imaging, **imaging)
    return dataclasses.replace(cell, scenario=dataclasses.replace(scenario, imaging=new))


def with_lens(cell, lens):
    calibration = dataclasses.replace(cell.scenario.calibration, lens=lens)
    return dataclasses.replace(
        cell,
        scenario=dataclasses.replace(cell.scenario, calibration=calibration),
        true_calibration=calibration,
    )


def tilted(cell, tilt_rad):
    """The cell with its targets tilted about an axis askew to the image."""
    normal = np.array([np.sin(tilt_rad) * 0.8, np.sin(tilt_rad) * 0.6, np.cos(tilt_rad)])
    part = dataclasses.replace(
        cell.true_part,
        targets=tuple(dataclasses.replace(t, normal=normal) for t in cell.true_part.targets),
    )
    return dataclasses.replace(cell, true_part=part)


def pose_at_stop(cell, k):
    rotation = RigidTransform.from_euler_xyz_rad(
        *cell.scenario.machine.spindle_euler_xyz_rad
    ).rotation
    return RigidTransform(rotation=rotation, translation_mm=cell.stops[k].spindle_in_machine_mm)


def camera_T_target(cell, k):
    """By omm_core's transforms, for the target that stop k is for."""
    target = next(t for t in scene_of(cell).targets if t.id == cell.stops[k].target_id)
    machine_T_camera = (
        pose_at_stop(cell, k)
        @ spindle_T_taper(cell.gamma_s_rad)
        @ cell.scenario.calibration.taper_T_camera
    )
    return machine_T_camera.inverse() @ cell.machine_T_part @ target.part_T_target


def projected_dot(cell, k):
    """Centroid and bounding box of the dot's outline, by omm_core's lens."""
    angles = np.linspace(0.0, 2 * np.pi, 5000, endpoint=False)
    radius_mm = cell.scenario.part.target(cell.stops[k].target_id).dot_diameter_mm / 2
    circle = radius_mm * np.stack([np.cos(angles), np.sin(angles), np.zeros(5000)], axis=-1)
    outline = cell.scenario.calibration.lens.project(camera_T_target(cell, k) @ circle)
    x, y = (outline - outline[0]).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    centroid = [np.sum((c + np.roll(c, -1)) * cross) / (3 * np.sum(cross)) for c in (x, y)]
    return outline[0] + centroid, outline.min(axis=0), outline.max(axis=0)


@pytest.fixture(scope="module")
def cell():
    return draw(load_scenario("bench"), 7)


@pytest.fixture(scope="module")
def camera(cell):
    return SimulatedCamera(cell)


def both_lenses(cell):
    brown = cell.scenario.calibration.lens
    return {"brown_photogrammetric": brown, "plumb_bob": brown.to_plumb_bob()[0]}


@pytest.mark.parametrize("model", ["brown_photogrammetric", "plumb_bob"])
def test_rays_agree_with_the_core(cell, model):
    lens = both_lenses(cell)[model]
    pixels = lens.pixel_grid(31)
    # The plane z = 1 in front of the camera shows the rays themselves.
    seen = see_plane(lens_numbers(lens), np.eye(3), pixels)
    np.testing.assert_allclose(seen, lens.rays(pixels)[:, :2], rtol=0, atol=1e-12)


@pytest.mark.parametrize("model", ["brown_photogrammetric", "plumb_bob"])
@pytest.mark.parametrize("tilt_deg", [0.0, 40.0])
@pytest.mark.parametrize("stop", [0, 1, 5])
def test_the_dot_is_imaged_where_the_core_projects_it(cell, model, tilt_deg, stop):
    cell = tilted(with_lens(cell, both_lenses(cell)[model]), np.radians(tilt_deg))
    pose = pose_at_stop(cell, stop)
    # All that differs between the two is the film, in the light that falls on it.
    film = SimulatedCamera(changed(cell, target_dn=205.0)).ideal(pose).astype(float)
    film -= SimulatedCamera(changed(cell, target_dn=105.0)).ideal(pose)

    expected, low, high = projected_dot(cell, stop)
    first = np.floor(low).astype(int) - 6
    last = np.ceil(high).astype(int) + 6
    window = film[first[1] : last[1] + 1, first[0] : last[0] + 1]
    rows, cols = np.mgrid[first[1] : last[1] + 1, first[0] : last[0] + 1].astype(float)
    x, y = (cols - expected[0]) / 40, (rows - expected[1]) / 40
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    whole = cv2.erode((window > 0.8 * window.max()).astype(np.uint8), np.ones((9, 9))) > 0
    light = terms @ np.linalg.lstsq(terms[whole], window[whole], rcond=None)[0]
    cover = window / light
    centre = np.array([np.sum(cover * cols), np.sum(cover * rows)]) / np.sum(cover)
    np.testing.assert_allclose(centre, expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize("name", ["bench", "industrial"])
def test_every_stop_shows_its_target_whole_and_readable(name):
    cell = draw(load_scenario(name), 11)
    camera = SimulatedCamera(cell)
    family = scene_of(cell).family
    for k, stop in enumerate(cell.stops):
        image = camera.image(pose_at_stop(cell, k), frame=k)
        centre, low, high = projected_dot(cell, k)
        radius = (high - low).mean() / 2
        # Clockwise as the viewer sees it: from col towards row.
        angles = 2 * np.pi * np.arange(20 * family.bits) / (20 * family.bits)
        around = centre + radius * family.read_ratio * np.stack(
            [np.cos(angles), np.sin(angles)], axis=-1
        )
        cols, rows = np.round(around).astype(int).T
        assert cols.min() > 0
        assert rows.min() > 0
        assert cols.max() < image.shape[1]
        assert rows.max() < image.shape[0]
        bright = image[rows, cols] > 60
        sectors = [  # at whichever phase the sectors are read most clearly
            np.roll(bright, -shift).reshape(family.bits, 20) for shift in range(20)
        ]
        clearest = max(sectors, key=lambda s: np.abs(s.mean(axis=1) - 0.5).sum())
        code = int("".join("1" if bit else "0" for bit in clearest.mean(axis=1) > 0.5), 2)
        assert smallest_rotation(code, family.bits) == family.code_of(stop.target_id)


def test_equal_frames_are_equal_and_others_differ(cell, camera):
    pose = pose_at_stop(cell, 0)
    first = camera.image(pose, frame=1)
    np.testing.assert_array_equal(first, SimulatedCamera(cell).image(pose, frame=1))
    assert np.mean(first != camera.image(pose, frame=2)) > 0.5


def test_cells_of_different_seeds_look_different(cell, camera):
    other = SimulatedCamera(draw(cell.scenario, 8))
    pose = pose_at_stop(cell, 0)
    assert np.abs(camera.ideal(pose) - other.ideal(pose)).mean() > 1.0


def test_the_kept_image_of_a_resting_spindle_is_the_one_rendered_anew(cell, camera):
    here, there = pose_at_stop(cell, 0), pose_at_stop(cell, 1)
    first = camera.ideal(here)
    assert camera.ideal(here) is first
    camera.ideal(there)
    again = camera.ideal(here)
    assert again is not first
    np.testing.assert_array_equal(again, first)


def test_noise_has_the_variance_of_photons_and_reading(cell, camera):
    imaging = cell.scenario.imaging
    pose = pose_at_stop(cell, 0)
    ideal = camera.ideal(pose).astype(float)
    noise = camera.image(pose, frame=3, bits=16) / 256.0 - ideal
    for low, high in ((10, 12), (20, 25), (150, 190)):
        chosen = noise[(ideal > low) & (ideal < high)]
        mean_dn = ideal[(ideal > low) & (ideal < high)].mean()
        law = imaging.read_noise_dn**2 + (mean_dn - imaging.black_dn) / imaging.electrons_per_dn
        spread = 5 / len(chosen) ** 0.5
        assert chosen.var() == pytest.approx(law, rel=5 * 2**0.5 * spread / 5 + 0.003)
        assert chosen.mean() == pytest.approx(0.0, abs=spread * law**0.5)


def test_16_bits_say_the_same_as_8_more_finely(cell, camera):
    pose = pose_at_stop(cell, 0)
    coarse, fine = (camera.image(pose, frame=4, bits=bits) for bits in (8, 16))
    assert (coarse.dtype, fine.dtype) == (np.uint8, np.uint16)
    assert coarse.shape == fine.shape == (1944, 2592)
    unclipped = (coarse > 0) & (coarse < 255)
    assert np.abs(fine[unclipped] / 256.0 - coarse[unclipped]).max() <= 0.51
    bare = camera.image(pose, frame=0, noise=False)
    assert np.abs(bare - np.clip(camera.ideal(pose), 0, 255)).max() <= 0.501


def test_light_falls_off_from_the_middle_to_the_corners_by_the_closed_form(cell):
    """Without ring light's radius: vignetting cosⁿ, inverse square and incidence (cos³)."""
    plain = changed(
        cell, background_contrast=0.0, reflections=0, ring_light_radius_mm=0.0, black_dn=0.0
    )
    ideal = SimulatedCamera(plain).ideal(pose_at_stop(cell, 0))
    rays = cell.scenario.calibration.lens.rays(np.array([[1290.0, 970.0], [40.0, 40.0]]))
    cos = 1 / np.linalg.norm(rays, axis=1)
    measured = [ideal[960:980, 1280:1300].mean(), ideal[30:50, 30:50].mean()]
    # The plate is tilted by some mm/m against the camera, which the closed form leaves out.
    assert measured[1] / measured[0] == pytest.approx((cos[1] / cos[0]) ** 7, rel=0.03)


def test_a_resting_spindle_makes_a_sharp_image_and_a_moving_one_smears(cell, camera):
    pose = pose_at_stop(cell, 0)
    assert len(camera.exposure_poses(lambda _: pose, 0)) == 1
    speed_mm_per_s = 100.0

    def moving(time_ns):
        shift = np.array([speed_mm_per_s * time_ns * 1e-9, 0.0, 0.0])
        return RigidTransform(rotation=pose.rotation, translation_mm=pose.translation_mm + shift)

    poses = camera.exposure_poses(moving, 0)
    assert len(poses) > 3
    smear_mm = speed_mm_per_s * cell.scenario.imaging.exposure_s
    np.testing.assert_allclose(
        np.mean([p.translation_mm for p in poses], axis=0), pose.translation_mm, atol=1e-9
    )

    _, low, high = (v.round().astype(int) for v in projected_dot(cell, 0))
    brighter, darker = (SimulatedCamera(changed(cell, target_dn=dn)) for dn in (205.0, 105.0))

    def second_moment(poses):
        film = brighter.ideal(poses).astype(float) - darker.ideal(poses)
        weights = film[low[1] - 12 : high[1] + 12, low[0] - 12 : high[0] + 12].sum(axis=0)
        cols = np.arange(len(weights))
        middle = np.sum(cols * weights) / weights.sum()
        return np.sum((cols - middle) ** 2 * weights) / weights.sum()

    grown_px2 = second_moment(poses) - second_moment(pose)
    focal_px = cell.scenario.calibration.lens.principal_distance_px
    smear_px = focal_px * smear_mm / cell.scenario.program.distance_mm
    # A box of length L adds L²/12 (its n steps: (1 − 1/n²) of that).
    assert grown_px2 == pytest.approx(smear_px**2 / 12 * (1 - len(poses) ** -2), rel=0.1)


def test_reflections_touch_no_label():
    for seed in range(4):
        scene = scene_of(draw(load_scenario("industrial"), seed))
        machine_T_plate = scene.machine_T_plate
        for spot in scene.reflections:
            spot_mm = machine_T_plate @ np.append(spot.centre_mm, 0.0)
            for target in scene.targets:
                away_mm = np.linalg.norm(
                    spot_mm - scene.machine_T_part @ target.part_T_target.translation_mm
                )
                assert away_mm > target.label_radius_mm + spot.semi_axes_mm[0] + REFLECTION_GAP_MM


def test_a_camera_that_looks_away_sees_nothing(cell, camera):
    pose = pose_at_stop(cell, 0)
    turned = RigidTransform(
        rotation=np.diag([1.0, -1.0, -1.0]) @ pose.rotation, translation_mm=pose.translation_mm
    )
    assert np.all(camera.ideal(turned) == cell.scenario.imaging.black_dn)


def test_a_camera_between_targets_sees_the_plate_alone(cell, camera):
    pose = pose_at_stop(cell, 0)
    between = RigidTransform(
        rotation=pose.rotation, translation_mm=pose.translation_mm + np.array([700.0, 400.0, 0])
    )
    plate = camera.ideal(between)
    assert plate.max() < 120.0
    assert 10.0 < plate.mean() < 25.0


def test_two_targets_in_view_are_both_imaged(cell):
    scenario = cell.scenario
    near = dataclasses.replace(scenario.part.targets[1], xyz_mm=np.array([60.0, 10.0, 5.0]))
    part = dataclasses.replace(scenario.part, targets=(scenario.part.targets[0], near))
    pair = dataclasses.replace(cell, true_part=part)
    image = SimulatedCamera(pair).ideal(pose_at_stop(cell, 0))
    lens = scenario.calibration.lens
    machine_T_camera = SimulatedCamera(pair).machine_T_camera(pose_at_stop(cell, 0))
    for target in part.targets:
        p_in_camera = machine_T_camera.inverse() @ cell.machine_T_part @ target.xyz_mm
        col, row = lens.project(p_in_camera[None])[0].round().astype(int)
        assert image[row, col] > 100.0
