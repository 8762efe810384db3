"""Laws of the lens models."""

from dataclasses import replace

import numpy as np
import pytest
from core_cameras import LENS_NAMES, LENSES, PAPER_LENS, PLUMB_BOB_LENS

from omm_core.errors import InputError
from omm_core.imaging.lens import check_lens

both = pytest.mark.parametrize("lens", LENSES, ids=LENS_NAMES)


@both
def test_rays_and_projection_are_inverse_over_the_whole_image(lens):
    pixels = lens.pixel_grid(31)
    again = lens.project(lens.rays(pixels) * np.linspace(100, 2000, len(pixels))[:, None])
    assert np.abs(again - pixels).max() < 1e-12 * lens.width_px


@both
def test_jacobian_is_the_derivative_of_the_projection(lens):
    points = lens.rays(lens.pixel_grid(9)) * 300.0
    step = 1e-3 * np.eye(3)
    numeric = [(lens.project(points + h) - lens.project(points - h)) / 2e-3 for h in step]
    _, analytic = lens.project_with_jacobian(points)
    assert np.abs(analytic - np.stack(numeric, axis=-1)).max() < 1e-8


def test_brown_corrects_measured_to_ideal_by_the_contracts_formula():
    lens = PAPER_LENS
    col, row = 2400.25, 130.5
    x, y = col - (2592 - 1) / 2 - lens.cl0_px, row - (1944 - 1) / 2 - lens.rw0_px
    r2 = x * x + y * y
    radial = lens.k1_px2 * r2 + lens.k2_px4 * r2 * r2
    ideal = np.array(
        [
            x + x * radial + lens.p1_px * (r2 + 2 * x * x) + 2 * lens.p2_px * x * y,
            y + y * radial + lens.p2_px * (r2 + 2 * y * y) + 2 * lens.p1_px * x * y,
        ]
    )
    ray = lens.rays(np.array([[col, row]]))[0]
    assert np.allclose(ray, [*(ideal * 0.0022 / 6.189), 1.0], rtol=1e-14)


def test_plumb_bob_is_opencvs():
    cv2 = pytest.importorskip("cv2")
    lens = PLUMB_BOB_LENS
    points = lens.rays(lens.pixel_grid(11)) * 412.0
    seen, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), lens.camera_matrix, lens.distortion
    )
    assert np.abs(seen.reshape(-1, 2) - lens.project(points)).max() < 1e-9


@both
def test_points_that_the_lens_cannot_see_are_nan(lens):
    unseen = np.array([[0.0, 0.0, -100.0], [1.0, 2.0, 0.0], [900.0, 0.0, 10.0]])
    assert np.isnan(lens.project(unseen)).all()


def test_conversion_tells_its_largest_error():
    plumb_bob, error_px = PAPER_LENS.to_plumb_bob()
    rays = PAPER_LENS.rays(PAPER_LENS.pixel_grid(97))
    difference = plumb_bob.project(rays) - PAPER_LENS.project(rays)
    assert 0.0 < np.hypot(*difference.T).max() <= error_px * 1.001 < 0.25


def test_conversion_of_a_lens_that_both_models_hold_is_exact():
    pinhole = replace(PAPER_LENS, k1_px2=0.0, k2_px4=0.0, p1_px=0.0, p2_px=0.0)
    plumb_bob, error_px = pinhole.to_plumb_bob()
    assert error_px < 1e-9
    again, error_px = plumb_bob.to_brown(pinhole.pixel_size_mm)
    assert error_px < 1e-6
    assert again.focal_length_mm == pytest.approx(pinhole.focal_length_mm, rel=1e-9)


def test_conversion_to_brown_comes_back_to_where_it_came_from():
    plumb_bob, there_px = PAPER_LENS.to_plumb_bob()
    again, back_px = plumb_bob.to_brown(PAPER_LENS.pixel_size_mm)
    assert PAPER_LENS.largest_difference_px(again) <= there_px + back_px
    assert again.k1_px2 == pytest.approx(PAPER_LENS.k1_px2, rel=0.01)


def test_a_lens_that_folds_back_is_refused():
    with pytest.raises(InputError, match="folds back"):
        check_lens(replace(PAPER_LENS, k1_px2=-3e-6))
    with pytest.raises(InputError, match="folds back"):
        check_lens(replace(PLUMB_BOB_LENS, k1=-5.0))
