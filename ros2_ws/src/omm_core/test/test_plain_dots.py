"""Plain dots are found wherever they are, as exactly as they claim, and nothing else is."""

import numpy as np
import pytest
from scipy.special import erf

from omm_core.errors import InputError
from omm_core.targets.plain import PlainOptions, find_plain_dots


def picture(ellipses, shape=(240, 320), noise=1.5, seed=0, blur=0.8, bright=150.0):
    """Blurred ellipses (col, row, larger, smaller semi-axis, angle) on uneven ground."""
    rows, cols = np.mgrid[: shape[0], : shape[1]].astype(float)
    image = 12.0 + 6.0 * np.sin(cols / 40.0)
    for col, row, a, b, angle in ellipses:
        u = (cols - col) * np.cos(angle) + (rows - row) * np.sin(angle)
        v = -(cols - col) * np.sin(angle) + (rows - row) * np.cos(angle)
        rho = np.hypot(u / a, v / b)
        steep = np.hypot(u / a**2, v / b**2) / np.maximum(rho, 1e-9)
        away = (rho - 1.0) / np.maximum(steep, 1e-9)
        image += bright * 0.5 * (1.0 - erf(away / (blur * np.sqrt(2))))
    image += np.random.default_rng(seed).normal(0, noise, shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("larger", "smaller"), [(5.0, 2.2), (7.0, 7.0), (12.0, 5.0), (30.0, 26.0)])
def test_centres_err_as_much_as_their_covariance_says(larger, smaller):
    ratios = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        pitch = max(80.0, 4.5 * larger)
        grid = [(i + 0.5, j + 0.5) for i in range(4) for j in range(2)]
        places = [tuple(pitch * np.array(at) + rng.uniform(-1, 1, 2)) for at in grid]
        shape = (int(2 * pitch), int(4 * pitch))
        image = picture(
            [(*p, larger, smaller, rng.uniform(0, 3)) for p in places], shape, seed=seed
        )
        dots = find_plain_dots(image)
        assert len(dots) == len(places)
        for dot in dots:
            truth = min(places, key=lambda p: np.hypot(*(dot.center_px - p)))
            error = dot.center_px - truth
            ratios.append(error @ np.linalg.solve(dot.covariance_px2, error) / 2.0)
            assert np.abs(error).max() < 0.2
    assert 0.6 < np.mean(ratios) < 1.6


def test_axes_are_those_of_the_ellipse():
    (dot,) = find_plain_dots(picture([(100.3, 90.6, 9.0, 5.0, 0.0)], noise=0.5))
    assert dot.spread_px2 == pytest.approx(np.diag([81.0, 25.0]), abs=2.2)
    assert dot.diameter_px == pytest.approx(2 * np.sqrt(45.0), abs=0.2)


def test_dark_dots_are_found_where_they_are_asked_for():
    image = 255 - picture([(100, 90, 8, 8, 0), (200, 90, 8, 8, 0)])
    assert len(find_plain_dots(image, PlainOptions(bright=False))) == 2
    assert find_plain_dots(image) == ()


def test_bars_arcs_and_glare_are_no_dots():
    image = picture([(60, 60, 7, 7, 0)])
    image[150:156, 20:200] = 180  # a bar
    rows, cols = np.mgrid[: image.shape[0], : image.shape[1]]
    arc = (np.abs(np.hypot(cols - 240, rows - 100) - 30) < 4) & (rows < 90)
    image[arc] = 170
    assert [round(float(d.center_px[0])) for d in find_plain_dots(image)] == [60]


def test_sectors_within_a_ring_are_no_dots():
    image = picture([(100, 90, 8, 8, 0), (120, 90, 3, 3, 0), (200, 90, 7, 7, 0)])
    ring = np.array([[100.0, 90.0, 24.0**-2, 0.0, 24.0**-2]])
    assert [round(float(d.center_px[0])) for d in find_plain_dots(image, rings=ring)] == [200]


def test_dots_at_the_border_and_noise_alone_give_nothing():
    cut = picture([(2, 90, 8, 8, 0), (160, 1, 5, 3, 0.4), (319, 239, 6, 6, 0)])
    assert find_plain_dots(cut) == ()
    noise = np.random.default_rng(1).integers(0, 255, (200, 200)).astype(np.uint8)
    assert len(find_plain_dots(noise)) <= 2


def test_sixteen_bits_give_the_same_centre():
    image = picture([(100.4, 90.2, 8, 6, 0.3)])
    (one,), (two,) = find_plain_dots(image), find_plain_dots(image.astype(np.uint16) * 200)
    assert one.center_px == pytest.approx(two.center_px, abs=1e-3)


def test_colour_is_refused():
    with pytest.raises(InputError, match="grey"):
        find_plain_dots(np.zeros((20, 20, 3), dtype=np.uint8))


def test_dots_on_dark_labels_need_not_be_brighter_than_the_part_around():
    places = [(60.2 + 80 * i, 60.7 + 90 * j, 6.0, 4.5, 0.4) for i in range(3) for j in range(2)]
    rows, cols = np.mgrid[:240, :320]
    image = picture(places, bright=190.0)
    label = np.zeros(image.shape, dtype=bool)
    for col, row, *_ in places:
        label |= (np.abs(cols - col) < 12) & (np.abs(rows - row) < 12)
    image[~label] = 200 + image[~label] // 4  # about as bright as the dots
    dots = find_plain_dots(image)
    assert len(dots) == len(places)
    found = np.array([dot.center_px for dot in dots])
    for col, row, *_ in places:
        assert np.linalg.norm(found - [col, row], axis=1).min() < 0.1


def test_flat_dots_are_found_in_16_bit_as_in_8():
    rng = np.random.default_rng(4)
    grid = [(50.0 + 74 * i, 40.0 + 54 * j) for i in range(4) for j in range(4)]
    flat = [(*(np.array(p) + rng.uniform(-1, 1, 2)), 7.4, 2.6, rng.uniform(0, 3)) for p in grid]
    image = picture(flat, noise=1.0, blur=0.7)
    eight, sixteen = (find_plain_dots(i) for i in (image, image.astype(np.uint16) * 200))
    assert len(eight) == len(flat)
    assert len(sixteen) == len(eight)
    for one, two in zip(eight, sixteen, strict=True):
        assert two.center_px == pytest.approx(one.center_px, abs=0.02)
