"""Laws of a whole run made without ROS."""

import numpy as np
import pytest

from omm_simulation.camera import SimulatedCamera
from omm_simulation.cell import draw
from omm_simulation.offline import Faults, ImageMessage, PoseMessage, run
from omm_simulation.scenario import load_scenario

START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def cell():
    return draw(load_scenario("bench"), 7)


def measured(cell, **options):
    messages = list(run(cell, start_ns=START_NS, **options))
    poses = [m for m in messages if isinstance(m, PoseMessage)]
    images = [m for m in messages if isinstance(m, ImageMessage)]
    return poses, images


@pytest.fixture(scope="module")
def sound(cell):
    return measured(cell)


def moved_mm(poses, stamp_ns, around_s=0.1):
    """How far the reported poses move around a time."""
    near = [p.machine_T_spindle.translation_mm for p in poses
            if abs(p.stamp_ns - stamp_ns) <= around_s * 1e9]  # fmt: skip
    return np.ptp(near, axis=0).max()


def test_an_image_comes_for_every_stop_in_order(cell, sound):
    _, images = sound
    assert [m.request for m in images] == list(range(1, 9))
    assert [m.target_id for m in images] == [stop.target_id for stop in cell.stops]
    assert np.all(np.diff([m.stamp_ns for m in images]) > 0)


def test_poses_come_at_100_hz_or_faster_before_and_after_each_image(sound):
    poses, images = sound
    stamps = np.array([p.stamp_ns for p in poses])
    assert stamps[0] == START_NS
    assert np.diff(stamps).max() <= 10_000_000
    assert stamps[-1] > images[-1].stamp_ns + 300_000_000
    fast, _ = measured(draw(load_scenario("bench"), 7), pose_rate_hz=250.0, speed_factor=2.0)
    assert np.diff([p.stamp_ns for p in fast]).max() <= 4_000_000


def test_the_spindle_stands_still_at_every_image(sound):
    poses, images = sound
    for image in images:
        assert moved_mm(poses, image.stamp_ns) < 1e-3
        assert len(image.true_machine_T_spindle) == 1


def test_equal_seeds_make_equal_runs(cell, sound):
    poses, images = sound
    again_poses, again_images = measured(cell)
    for a, b in zip(poses, again_poses, strict=True):
        np.testing.assert_array_equal(
            a.machine_T_spindle.translation_mm, b.machine_T_spindle.translation_mm
        )
    for a, b in zip(images, again_images, strict=True):
        assert a.stamp_ns == b.stamp_ns
        np.testing.assert_array_equal(a.image, b.image)


def test_what_goes_wrong_is_what_was_told_and_nothing_else(cell, sound):
    _, sound_images = sound
    faults = Faults(moving=frozenset({3}), stale=frozenset({5}), without_poses=frozenset({7}))
    poses, images = measured(cell, faults=faults)
    by_request = {m.request: m for m in images}

    assert moved_mm(poses, by_request[3].stamp_ns) > 1.0
    assert len(by_request[3].true_machine_T_spindle) > 1

    assert moved_mm(poses, by_request[5].stamp_ns) < 1e-3
    there = by_request[4].true_machine_T_spindle[0]
    np.testing.assert_array_equal(
        by_request[5].true_machine_T_spindle[0].translation_mm, there.translation_mm
    )
    apart = np.abs(by_request[5].image.astype(float) - by_request[4].image)
    assert apart.mean() < 5.0  # the same but for the noise

    stamps = np.array([p.stamp_ns for p in poses])
    after = stamps[stamps > by_request[7].stamp_ns][0]
    assert after - by_request[7].stamp_ns >= 290_000_000

    for image in sound_images:
        if image.request in (1, 2, 4, 6, 8):
            np.testing.assert_array_equal(image.image, by_request[image.request].image)


def test_a_mirrored_camera_delivers_mirrored_images(cell, sound):
    _, images = sound
    _, mirrored = measured(cell, faults=Faults(mirrored=True))
    for image, mirror in zip(images, mirrored, strict=True):
        np.testing.assert_array_equal(image.image[:, ::-1], mirror.image)


def test_a_bumped_target_appears_elsewhere_and_the_others_do_not(sound):
    _, images = sound
    bumped = draw(load_scenario("bench"), 7, bumped_id=8, bump_mm=(0.5, 0.0, 0.0))
    camera = SimulatedCamera(bumped)
    for image in images[2], images[4]:
        seen = camera.image(image.true_machine_T_spindle, frame=image.request)
        edges_moved = np.mean(np.abs(seen.astype(float) - image.image) > 60) > 1e-5
        assert edges_moved == (image.target_id == 8)
