"""Targets are found, numbered and centred; what is doubtful is refused with a reason."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from target_scenes import as_seen, target_image

from omm_core.errors import InputError
from omm_core.targets import DetectionOptions, TargetFamily, detect_targets

PHOTO = Path(__file__).parents[5] / "shared/data/photos/rings_14bit_aicon.jpg"
METASHAPE = TargetFamily.by_name("metashape12")


@pytest.mark.parametrize("name", ["aicon12", "aicon14", "metashape12", "metashape14", "aicon20"])
@pytest.mark.parametrize("bright", [True, False])
def test_every_family_and_polarity_is_read(name, bright):
    rng = np.random.default_rng(1)
    family = TargetFamily.by_name(name)
    for target_id in rng.integers(1, len(family) + 1, 8):
        image, centre = target_image(rng, target_id=int(target_id), name=name, bright=bright)
        found = detect_targets(as_seen(rng, image), family).targets
        assert [t.id for t in found] == [target_id]
        assert found[0].bright == bright
        assert np.abs(found[0].center_px - centre).max() < 0.03


@pytest.mark.parametrize(
    ("diameter_px", "tilt_deg", "blur_px", "contrast_dn"),
    [
        (12.0, 50.0, 0.8, 150.0),
        (12.0, 0.0, 1.5, 40.0),
        (8.0, 0.0, 0.7, 150.0),
        (120.0, 60.0, 2.0, 40.0),
        (60.0, 45.0, 1.0, 400.0),
    ],
)
def test_the_working_range_is_covered(diameter_px, tilt_deg, blur_px, contrast_dn):
    rng = np.random.default_rng(2)
    found = 0
    for target_id in range(1, 161, 8):
        image, _ = target_image(
            rng,
            target_id=target_id,
            diameter_px=diameter_px,
            blur_px=blur_px,
            tilt_deg=tilt_deg,
            contrast_dn=contrast_dn,
        )
        ids = [t.id for t in detect_targets(as_seen(rng, image), METASHAPE).targets]
        assert ids in ([target_id], [])
        found += bool(ids)
    assert found >= 19


def test_16_bit_gives_the_same_as_8_bit():
    rng = np.random.default_rng(3)
    image, centre = target_image(rng, target_id=7)
    seen = as_seen(np.random.default_rng(4), image, dtype=np.uint16)
    (target,) = detect_targets(seen, METASHAPE).targets
    assert target.id == 7
    assert np.abs(target.center_px - centre).max() < 0.02
    assert target.contrast_dn == pytest.approx(150.0 * 256.0, rel=0.01)


def test_saturated_dot_is_centred():
    rng = np.random.default_rng(5)
    for _ in range(5):
        image, centre = target_image(rng, contrast_dn=400.0)
        (target,) = detect_targets(as_seen(rng, image), METASHAPE).targets
        assert np.abs(target.center_px - centre).max() < 0.02


def test_a_chip_on_the_dot_is_noticed():
    rng = np.random.default_rng(6)
    for diameter in (20.0, 40.0, 80.0):
        image, centre = target_image(rng, diameter_px=diameter, chip=(0.9, 0.2, 0.25))
        for target in detect_targets(as_seen(rng, image), METASHAPE).targets:
            error = target.center_px - centre
            assert error @ np.linalg.solve(target.covariance_px2, error) < 25.0


def test_a_covered_sector_is_refused_not_misread():
    rng = np.random.default_rng(7)
    read = METASHAPE.read_ratio
    for target_id in range(1, 160, 8):
        turn = rng.uniform(0, 6.28)
        image, _ = target_image(
            rng,
            target_id=target_id,
            diameter_px=40.0,
            chip=(read * np.cos(turn), read * np.sin(turn), 0.5),
        )
        ids = [t.id for t in detect_targets(as_seen(rng, image), METASHAPE).targets]
        assert ids in ([target_id], [])


def test_a_ring_cut_by_the_border_is_refused_with_the_reason():
    rng = np.random.default_rng(8)
    image, centre = target_image(rng, diameter_px=30.0)
    cut = as_seen(rng, image)[:, : int(centre[0]) + 38]
    result = detect_targets(np.ascontiguousarray(cut), METASHAPE)
    assert not result.targets
    assert any("border" in refused.reason for refused in result.refused)


def test_another_familys_ring_is_not_read():
    rng = np.random.default_rng(9)
    for target_id in range(1, 140, 10):
        image, _ = target_image(rng, target_id=target_id, name="aicon12", diameter_px=40.0)
        assert not detect_targets(as_seen(rng, image), METASHAPE).targets


def test_a_mirrored_image_is_noticed_where_the_numbers_are_known():
    rng = np.random.default_rng(10)
    family = TargetFamily.by_name("aicon12")
    image, _ = target_image(rng, target_id=20, name="aicon12")
    mirrored = np.ascontiguousarray(as_seen(rng, image)[:, ::-1])
    (wrong,) = detect_targets(mirrored, family).targets
    assert wrong.id != 20
    result = detect_targets(mirrored, family, DetectionOptions(expected_ids=frozenset({20})))
    assert not result.targets
    assert "mirrored" in result.refused[0].reason


def test_the_same_number_twice_is_refused():
    rng = np.random.default_rng(11)
    image, _ = target_image(rng, target_id=5)
    twice = as_seen(rng, np.hstack([image, image]))
    result = detect_targets(twice, METASHAPE)
    assert not result.targets
    assert "2 times" in result.refused[0].reason


def test_outline_centring_is_offered():
    rng = np.random.default_rng(12)
    image, centre = target_image(rng)
    options = DetectionOptions(centring="outline")
    (target,) = detect_targets(as_seen(rng, image), METASHAPE, options).targets
    assert np.abs(target.center_px - centre).max() < 0.1


def test_what_is_no_grey_image_is_refused():
    with pytest.raises(InputError, match="uint8 or uint16"):
        detect_targets(np.zeros((9, 9, 3), np.uint8), METASHAPE)
    with pytest.raises(InputError, match="polarity"):
        detect_targets(np.zeros((99, 99), np.uint8), METASHAPE, DetectionOptions(polarity="x"))


@pytest.mark.parametrize("shape", [(1, 1), (23, 2000), (64, 64), (301, 97)])
def test_images_without_targets_are_empty(shape):
    image = np.random.default_rng(13).integers(0, 256, shape).astype(np.uint8)
    assert not detect_targets(image, METASHAPE).targets


@pytest.mark.skipif(not PHOTO.exists(), reason="the photograph lies outside this repository")
def test_all_targets_of_the_photograph_are_read():
    image = cv2.imread(str(PHOTO), cv2.IMREAD_GRAYSCALE)
    ids = {t.id for t in detect_targets(image, TargetFamily.by_name("aicon14")).targets}
    crude = {
        *range(1, 11),
        *range(15, 24),
        *range(41, 56),
        75,
        77,
        79,
        81,
        *range(379, 389),
        399,
        *range(401, 411),
    }
    runs = {*range(1, 56), *range(70, 90), *range(375, 415)}
    assert crude <= ids <= runs
