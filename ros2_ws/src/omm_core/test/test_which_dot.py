"""Which of several bright things is the dot is told by the camera on which they agree."""

import cv2
import numpy as np
import pytest
from test_calibration_by_places import SENSOR, TRUTH, places_before

from omm_core.camera_calibration.model import project_with_derivatives
from omm_core.camera_calibration.single_dot import find_bright_dots
from omm_core.camera_calibration.which_dot import agreeing_things

DOT_MM = 5.0


def images(seed, others):
    """Return places, centres and diameters of the dot and of other things, and which is the dot."""
    rng = np.random.default_rng(seed)
    places = places_before(TRUTH)[rng.permutation(90)[:40]]
    dots = project_with_derivatives(SENSOR, TRUTH, places[:, None])[0]
    sizes = DOT_MM * 2813.0 / -(places[:, 2] - TRUTH[9])
    centres, diameters, which = [], [], []
    for dot, size in zip(dots, sizes, strict=True):
        things = [(dot, size), *others(rng, dot, size)]
        order = rng.permutation(len(things))
        centres.append(np.array([things[i][0] for i in order]))
        diameters.append(np.array([things[i][1] for i in order]))
        which.append(int(np.flatnonzero(order == 0)[0]))
    return places, centres, diameters, which


def blobs(rng, dot, size):
    return [(rng.uniform([0, 0], [2592, 1944]), rng.uniform(10, 100)) for _ in range(3)]


def ghost(rng, dot, size):
    return [(np.array([2591.0, 1943.0]) - dot, 51.0)]


def companion(rng, dot, size):
    return [(dot + [150.0, 40.0], 40.0)]


@pytest.mark.parametrize("others", [blobs, ghost, companion])
def test_the_dot_is_found_among_other_things_without_a_camera(others):
    places, centres, diameters, which = images(1, others)
    found = agreeing_things(SENSOR, places, centres, diameters, DOT_MM)
    right = sum(a == b for a, b in zip(found, which, strict=True))
    # One of many things may lie where the dot would do as well: it is weeded out later.
    assert right >= 38


def test_an_image_without_the_dot_or_with_nothing_has_none():
    places, centres, diameters, _ = images(2, blobs)
    centres[5], diameters[5] = np.zeros((0, 2)), np.zeros(0)
    found = agreeing_things(SENSOR, places, centres, diameters, DOT_MM)
    assert found[5] is None


def test_few_images_decide_nothing():
    places, centres, diameters, _ = images(3, blobs)
    found = agreeing_things(SENSOR, places[:9], centres[:9], diameters[:9], DOT_MM)
    assert found == [None] * 9


def test_a_dot_that_is_dimmer_than_a_reflection_is_found():
    rows, cols = np.mgrid[:300, :400]
    image = np.full((300, 400), 5.0)
    for row, col, radius, level in [(100, 120, 15, 60), (200, 300, 12, 240)]:
        image += level * (np.hypot(rows - row, cols - col) < radius)
    noise = np.random.default_rng(0).normal(0, 1, image.shape)
    seen = cv2.GaussianBlur(image, (0, 0), 0.8) + noise
    found = find_bright_dots(np.clip(seen, 0, 255).astype(np.uint8))
    assert sorted(np.round(d.center_px).tolist() for d in found) == [[120, 100], [300, 200]]
