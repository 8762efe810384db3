"""A plain bright dot is found to a hundredth of a pixel, whatever else is bright."""

import numpy as np
import pytest

from omm_core.camera_calibration.single_dot import find_bright_dots


def disc_image(dots, shape=(300, 400), noise=1.0, seed=0, dtype=np.uint8, bright=180.0):
    """Blurred discs (col, row, radius), exact to the blur's edge profile."""
    rows, cols = np.mgrid[: shape[0], : shape[1]].astype(float)
    image = np.full(shape, 8.0)
    for col, row, radius in dots:
        edge = radius - np.hypot(cols - col, rows - row)
        image += bright / (1.0 + np.exp(-np.clip(edge, -30, 30) / 0.35))
    image += np.random.default_rng(seed).normal(0, noise, shape)
    return np.clip(np.rint(image * (1 if dtype == np.uint8 else 200)), 0, None).astype(dtype)


@pytest.mark.parametrize("radius", [6.5, 15.0, 45.0])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_centre_is_found(radius, dtype):
    for seed in range(4):
        place = np.array([200.0, 150.0]) + np.random.default_rng(seed).uniform(-1, 1, 2)
        (dot,) = find_bright_dots(disc_image([(*place, radius)], seed=seed, dtype=dtype))
        assert np.abs(dot.center_px - place).max() < 0.02
        assert dot.diameter_px == pytest.approx(2 * radius, abs=0.3)
        assert 1e-7 < dot.covariance_px2[0, 0] < 1e-3


def test_all_bright_round_things_are_told_and_others_are_not():
    image = disc_image([(100, 100, 12), (300, 200, 20)])
    image[30:40, 150:390] = 200  # a bright bar
    found = sorted(dot.center_px[0] for dot in find_bright_dots(image))
    assert found == pytest.approx([100, 300], abs=0.05)


def test_a_dark_image_and_a_dot_cut_by_the_border_give_nothing():
    assert find_bright_dots(disc_image([])) == []
    assert find_bright_dots(disc_image([(2, 150, 12)])) == []
