"""A target that one side of the light leaves dark is read as it is, with a wider covariance."""

import numpy as np
import pytest
from target_scenes import as_seen, target_image

from omm_core.targets import detect_targets
from omm_core.targets.coded.families import TargetFamily
from omm_core.targets.coded.uneven_outline import outline_uneven

FAMILY = TargetFamily.by_name("aicon14")
DIAMETER_PX = 16.0


def scene(rng, target_id, fall, faint=1.0):
    """A bright target under light that falls exponentially, `fall` of the logarithm to the ring."""
    image, centre = target_image(
        rng, target_id=target_id, name="aicon14", diameter_px=DIAMETER_PX, blur_px=0.8
    )
    rows, cols = np.mgrid[: image.shape[0], : image.shape[1]]
    angle = rng.uniform(0, 2 * np.pi)
    along = (cols - centre[0]) * np.cos(angle) + (rows - centre[1]) * np.sin(angle)
    ring_px = 0.5 * DIAMETER_PX * 0.5 * (FAMILY.ring_inner_ratio + FAMILY.ring_outer_ratio)
    light = np.exp(fall * along / ring_px)
    return as_seen(rng, 0.5 * faint * image * light, read_dn=0.7), centre


@pytest.mark.parametrize("fall", [0.3, 0.6])
def test_no_number_is_misread_and_most_are_read(fall):
    rng = np.random.default_rng(round(100 * fall))
    read, normalised = 0, []
    for target_id in range(1, 81):
        image, centre = scene(rng, target_id, fall)
        for target in detect_targets(image, FAMILY).targets:
            assert target.id == target_id
            read += 1
            off = target.center_px - centre
            normalised.append(off @ np.linalg.solve(target.covariance_px2, off))
    assert read >= 72
    assert np.mean(normalised) < 2.0 * 1.6  # two coordinates


def under_a_beams_edge(rng, target_id, dark, width):
    """A bright target across which a beam ends: `dark` of its light is left, over `width` radii."""
    image, centre = target_image(
        rng, target_id=target_id, name="aicon14", diameter_px=DIAMETER_PX, blur_px=0.6
    )
    rows, cols = np.mgrid[: image.shape[0], : image.shape[1]]
    angle, place = rng.uniform(0, 2 * np.pi), rng.uniform(-1.5, 1.5)
    along = (cols - centre[0]) * np.cos(angle) + (rows - centre[1]) * np.sin(angle)
    edge = 1.0 / (1.0 + np.exp(-1.7 * (along / (0.5 * DIAMETER_PX) - place) / width))
    return as_seen(rng, 0.5 * image * (dark + (1.0 - dark) * edge), read_dn=0.7), centre


@pytest.mark.parametrize(
    ("dark", "width", "least"), [(0.2, 1.0, 38), (0.4, 0.3, 32), (0.2, 0.4, 30)]
)
def test_a_beams_edge_on_the_target_hides_no_sector_and_is_in_the_covariance(dark, width, least):
    """What lies in the shadow is dark, not clear; the dot's dark side is a part of the dot."""
    rng = np.random.default_rng(round(1000 * dark + 10 * width))
    read, normalised = 0, []
    for target_id in range(1, 481, 12):
        image, centre = under_a_beams_edge(rng, target_id, dark, width)
        for target in detect_targets(image, FAMILY).targets:
            assert target.id == target_id
            read += 1
            off = target.center_px - centre
            assert np.hypot(*off) < 0.06 * DIAMETER_PX
            normalised.append(off @ np.linalg.solve(target.covariance_px2, off))
    assert read >= least
    assert np.mean(normalised) < 2.0 * 2.0  # two coordinates


def test_the_covariance_grows_with_the_fall():
    rng = np.random.default_rng(3)
    widths = []
    for fall in (0.0, 0.6):
        found = [
            t
            for target_id in range(1, 31)
            for t in detect_targets(scene(rng, target_id, fall)[0], FAMILY).targets
        ]
        widths.append(np.median([np.trace(t.covariance_px2) for t in found]))
    assert widths[1] > 2.0 * widths[0]


def test_a_faint_target_is_found():
    """A contrast of 10 grey values of 255, above a noise of less than one."""
    rng = np.random.default_rng(5)
    found = sum(
        [t.id for t in detect_targets(scene(rng, i, 0.0, faint=0.14)[0], FAMILY).targets] == [i]
        for i in range(1, 41)
    )
    assert found >= 38


def test_the_levels_of_the_outline_are_the_dots_and_the_grounds():
    """No ray writes into another's levels: all see the same of a round dot under even light."""
    rows, cols = np.mgrid[:80, :80]
    inside = 1.0 / (1.0 + np.exp((np.hypot(rows - 40.0, cols - 40.0) - 12.0) / 0.5))
    image = np.round(20.0 + 180.0 * inside).astype(np.uint8)
    shape, ok = outline_uneven(image, np.array([40.0, 40.0, 1 / 144, 0.0, 1 / 144, 1.0]), 1.0)
    assert ok
    assert shape[5] > 0.92 * 200.0
    assert shape[6] < 1.1 * 20.0
