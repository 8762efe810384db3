"""Pairing images with spindle poses: whatever happens, and in whatever order it comes."""

import itertools

import numpy as np
import pytest

from omm_core.errors import InputError
from omm_core.geometry import RigidTransform
from omm_core.session.pairing import PairingOptions, PoseTrack

MS = 1_000_000
IMAGE = 1_000 * MS


def pose(x_mm=100.0, turn_rad=0.0):
    return RigidTransform.from_euler_xyz_rad(0.0, 0.0, 0.3 + turn_rad, (x_mm, -20.0, 500.0))


def samples(x_of_ms=lambda ms: 100.0, start=700, stop=1301, step=10, turn_of_ms=lambda ms: 0.0):
    return [(ms * MS, pose(x_of_ms(ms), turn_of_ms(ms))) for ms in range(start, stop, step)]


def judged(track_samples, options=None):
    track = PoseTrack(options)
    for stamp_ns, transform in track_samples:
        track.add(stamp_ns, transform)
    return track.judge(IMAGE)


def test_a_spindle_that_stood_still_has_its_pose():
    judgement = judged(samples())
    assert judgement.reason is None
    assert not judgement.pending
    assert np.allclose(judgement.machine_T_spindle.translation_mm, [100, -20, 500], atol=1e-12)
    assert np.allclose(judgement.machine_T_spindle.rotation, pose().rotation, atol=1e-12)


def test_encoder_noise_below_the_tolerance_is_averaged():
    random = np.random.default_rng(1)
    judgement = judged(samples(lambda ms: 100.0 + random.uniform(-0.002, 0.002)))
    assert judgement.reason is None
    assert abs(judgement.machine_T_spindle.translation_mm[0] - 100.0) < 0.001


@pytest.mark.parametrize(
    ("given", "reason", "pending"),
    [
        ([], "no spindle pose after", True),
        (samples(stop=991), "no spindle pose after", True),
        (samples(start=1010), "no spindle pose before", False),
        (samples(stop=1031), "a gap of 0.070 s", True),
        (samples(start=970), "a gap of 0.070 s", False),
        (samples(stop=961) + samples(start=1050), "a gap of 0.090 s", False),
        (samples(lambda ms: 100 + 0.05 * (ms - 1000)), "moved by 1", False),
        # A creep of 0.1 mm/s: 1 µm from sample to sample, 0.02 mm over the window.
        (samples(lambda ms: 100 + 1e-4 * ms), "moved by 0.02", False),
        (samples(lambda ms: 100.0 + (ms > 1040)), "moved by 1.000 mm", False),
        (samples(turn_of_ms=lambda ms: 1e-6 * ms), "turned by 0.2", False),
        # A clock that jumps back: samples of another place between those of this one.
        (samples() + samples(lambda ms: 300.0, start=905, stop=1100), "moved by 200", False),
        # Two poses of one stamp: one of them is wrong, and nobody knows which.
        ([*samples(), (IMAGE, pose(101.0))], "moved by 1.000 mm", False),
    ],
)
def test_what_did_not_demonstrably_stand_still_is_refused_with_the_reason(given, reason, pending):
    judgement = judged(given)
    assert judgement.machine_T_spindle is None
    assert reason in judgement.reason
    assert judgement.pending == pending


def test_the_judgement_does_not_depend_on_the_order_of_arrival_nor_on_repetition():
    random = np.random.default_rng(3)
    given = samples(lambda ms: 100.0 + 0.001 * np.sin(ms))
    expected = judged(given).machine_T_spindle
    for _ in range(20):
        shuffled = [given[i] for i in random.integers(0, len(given), 50)] + [
            given[i] for i in random.permutation(len(given))
        ]
        found = judged(shuffled).machine_T_spindle
        assert np.array_equal(found.rotation, expected.rotation)
        assert np.array_equal(found.translation_mm, expected.translation_mm)


def test_conflicting_poses_of_one_stamp_are_judged_the_same_in_any_order():
    options = PairingOptions(tolerance_mm=10.0)
    conflict = [(IMAGE, pose(100.0)), (IMAGE, pose(101.0)), (IMAGE, pose(102.0))]
    found = [
        judged([*samples(), *order], options).machine_T_spindle.translation_mm
        for order in itertools.permutations(conflict)
    ]
    assert all(np.array_equal(found[0], other) for other in found)


def test_motion_before_and_after_the_window_does_not_matter():
    moving = samples(lambda ms: 100.0 + max(0, 880 - ms) + max(0, ms - 1120))
    assert judged(moving).reason is None


def test_an_image_exactly_at_a_sample_needs_samples_around_it():
    assert judged(samples(start=890, stop=1111)).reason is None
    assert "after" not in str(judged(samples(stop=1001)).reason)
    assert "gap" in judged(samples(stop=1001)).reason


def test_50_hz_with_one_sample_lost_is_enough():
    sparse = [s for s in samples(step=20) if s[0] != 960 * MS]
    assert judged(sparse).reason is None


def test_options_that_mean_nothing_are_refused():
    with pytest.raises(InputError, match="gap_ns"):
        PairingOptions(gap_ns=0)


def test_forgetting_changes_no_judgement_of_the_images_it_was_told():
    given = samples(lambda ms: 100.0 + 0.001 * np.sin(ms), start=-20_000, stop=20_000)
    images = [-15_000 * MS, IMAGE, IMAGE + 3 * MS]
    track = PoseTrack()
    for stamp_ns, transform in given:
        track.add(stamp_ns, transform)
    before = [track.judge(stamp_ns) for stamp_ns in images]
    track.forget(15_000 * MS, images)
    assert len(track) < 600
    for stamp_ns, judgement in zip(images, before):
        again = track.judge(stamp_ns)
        assert again.pending == judgement.pending
        assert np.array_equal(
            again.machine_T_spindle.translation_mm, judgement.machine_T_spindle.translation_mm
        )
    assert track.judge(-5_000 * MS).machine_T_spindle is None
    assert track.judge(16_000 * MS).machine_T_spindle is not None


def test_a_sample_that_comes_late_changes_what_was_judged_before():
    track = PoseTrack()
    for stamp_ns, transform in samples():
        track.add(stamp_ns, transform)
    assert track.judge(IMAGE).machine_T_spindle is not None
    track.add(IMAGE + 3 * MS, pose(101.0))
    assert "moved by 1.000 mm" in track.judge(IMAGE).reason
