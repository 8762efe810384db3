"""The image of a circle: what is left after the model, against densely projected circles."""

import numpy as np
import pytest
from core_cameras import LENS_NAMES, LENSES
from scipy.optimize import least_squares

from omm_core.imaging.circle import CircleCentre, centre_weights, circle_points, project_circles
from omm_core.imaging.lens import BrownPhotogrammetric

both = pytest.mark.parametrize("lens", LENSES, ids=LENS_NAMES)
TILTS_DEG = (0.0, 20.0, 45.0)
# diameter and distance, mm: the working range of the paper, to 15 mm at 150 mm
DOTS = [(8.0, 300.0), (15.0, 300.0), (8.0, 150.0), (15.0, 150.0)]


def circles(lens, diameter_mm, distance_mm, count=24):
    """Return centres and normals (N, 3) of circles that lie wholly in the image, corners too."""
    random = np.random.default_rng(5)
    margin = 1.2 * diameter_mm / 2 / distance_mm * 2900.0
    size = np.array([lens.width_px, lens.height_px])
    pixels = random.uniform(0, 1, (count, 2))
    pixels[::2] = pixels[::2].round()  # every other one in a corner
    pixels = np.clip(pixels * size, margin, size - margin)
    tilt = np.radians(np.resize(TILTS_DEG, count))
    azimuth = random.uniform(0, 2 * np.pi, count)
    normals = np.column_stack(
        [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)]
    )
    return lens.rays(pixels) * distance_mm, normals


def dense_outline(lens, centre, normal, diameter_mm, count=720):
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    a = np.cross(normal, axis) / np.linalg.norm(np.cross(normal, axis))
    t = 2 * np.pi * np.arange(count)[:, None] / count
    return lens.project(
        centre + diameter_mm / 2 * (np.cos(t) * a + np.sin(t) * np.cross(normal, a))
    )


def centre_of_area(outline):
    """Green's theorem on the polygon of the outline."""
    origin = outline.mean(axis=0)
    p = outline - origin
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    return origin + ((p + q) * cross[:, None]).sum(axis=0) / (3 * cross.sum())


def centre_of_best_ellipse(outline):
    """Least squares of distances to the ellipse (Sampson), weighted by the outline's length."""
    start = centre_of_area(outline)
    p = outline - start
    length = np.linalg.norm(np.roll(p, -1, axis=0) - np.roll(p, 1, axis=0), axis=1)
    shape = np.linalg.inv(2 * p.T @ p / len(p))

    def distances(values):
        matrix = np.array([[values[2], values[3]], [values[3], values[4]]])
        from_centre = p - values[:2]
        gradient = from_centre @ matrix
        value = np.einsum("ni,ni->n", gradient, from_centre) - 1.0
        return value / (2 * np.linalg.norm(gradient, axis=1)) * np.sqrt(length)

    scale = [1.0, 1.0, shape[0, 0], shape[0, 0], shape[1, 1]]
    first = [0.0, 0.0, shape[0, 0], shape[0, 1], shape[1, 1]]
    fit = least_squares(distances, first, x_scale=scale, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return start + fit.x[:2]


@both
@pytest.mark.parametrize(("diameter_mm", "distance_mm"), DOTS)
@pytest.mark.parametrize(
    ("kind", "measured"),
    [(CircleCentre.AREA, centre_of_area), (CircleCentre.OUTLINE, centre_of_best_ellipse)],
    ids=["area", "outline"],
)
def test_bias_left_is_below_2_thousandths_of_a_pixel(
    lens, diameter_mm, distance_mm, kind, measured
):
    centres, normals = circles(lens, diameter_mm, distance_mm)
    diameters = np.full(len(centres), diameter_mm)
    predicted = project_circles(lens, centres, normals, diameters, kind)
    outlines = [
        dense_outline(lens, centre, normal, diameter_mm)
        for centre, normal in zip(centres, normals, strict=True)
    ]
    bias = predicted - np.array([measured(outline) for outline in outlines])
    assert np.hypot(*bias.T).max() < 0.002
    # The test sees what it is about: the image of the centre is far from it.
    assert np.hypot(*(predicted - lens.project(centres)).T).max() > 0.1


def test_without_distortion_the_centre_is_that_of_the_conic():
    """Pole of the line at infinity of the dual conic p pᵀ − r² (I − n nᵀ)."""
    lens = BrownPhotogrammetric(
        width_px=2592, height_px=1944, focal_length_mm=6.189, pixel_size_mm=0.0022
    )
    centres, normals = circles(lens, 8.0, 300.0)
    along = normals[:, 2:]
    pole = centres[:, 2:] * centres - 4.0**2 * (np.array([0, 0, 1.0]) - along * normals)
    diameters = np.full(len(centres), 8.0)
    for kind in CircleCentre:
        predicted = project_circles(lens, centres, normals, diameters, kind)
        assert np.abs(predicted - lens.project(pole)).max() < 1e-5


@both
@pytest.mark.parametrize("kind", list(CircleCentre))
@pytest.mark.parametrize(
    ("diameter_mm", "distance_mm", "largest"), [(8.0, 300.0, 1e-4), (15.0, 150.0, 1e-3)]
)
def test_weights_held_constant_leave_out_no_more_than_this_of_the_derivative(
    lens, kind, diameter_mm, distance_mm, largest
):
    centres, normals = circles(lens, diameter_mm, distance_mm, count=12)
    for centre, normal in zip(centres, normals, strict=True):
        points = circle_points(centre, normal, diameter_mm)
        pixels, jacobians = lens.project_with_jacobian(points)
        weights = centre_weights(pixels, kind)

        def centre_of(moved, normal=normal):
            outline = lens.project(circle_points(moved, normal, diameter_mm))
            return np.einsum("kij,kj->i", centre_weights(outline, kind), outline)

        analytic = np.einsum("kij,kjl->il", weights, jacobians)
        steps = 1e-3 * np.eye(3)
        numeric = [(centre_of(centre + h) - centre_of(centre - h)) / 2e-3 for h in steps]
        error = np.abs(analytic - np.transpose(numeric))
        assert error.max() < largest * np.abs(analytic).max()


@both
def test_the_sign_of_the_normal_does_not_matter(lens):
    centres, normals = circles(lens, 8.0, 300.0)
    diameters = np.full(len(centres), 8.0)
    one, other = (project_circles(lens, centres, s * normals, diameters) for s in (1, -1))
    assert np.abs(one - other).max() < 1e-5


@both
def test_a_circle_that_is_not_wholly_in_front_of_the_camera_is_nan(lens):
    behind = project_circles(lens, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]], [8.0])
    assert np.isnan(behind).all()
