"""Calibration by a CMM: the truth is found from nothing, sigma is honest, open sets are told."""

import dataclasses

import numpy as np
import pytest

from omm_core.camera_calibration.cmm import calibrate_by_places
from omm_core.camera_calibration.model import Sensor, project_with_derivatives
from omm_core.camera_calibration.patterns import planes_of
from omm_core.camera_calibration.seven import standard_measurement
from omm_core.errors import MeasurementError
from omm_core.geometry import rotation_from_euler_xyz_rad
from omm_core.imaging.circle import (
    centre_weights,
    centre_weights_of_many,
    circle_points,
    project_circles,
)

SENSOR = Sensor(name="test", width_px=2592, height_px=1944, pixel_size_mm=0.0022)
# Table 1 of the paper, alpha with pi added (the contract).
TRUTH = np.array(
    [6.189, -8.732, 27.52, 2.997e-8, -1.937e-15, -6.188e-8, 3.408e-7,
     -2.139, 0.301, -320.2, np.pi - 0.003, -0.009, 0.03]
)  # fmt: skip
NORMAL = np.array([0.0, 0.0, 1.0])


def places_before(camera, distances=(130, 250, 500), columns=6, rows=5):
    lens = SENSOR.lens(camera)
    grid = np.stack(
        np.meshgrid(np.linspace(150, 2440, columns), np.linspace(150, 1790, rows)), axis=-1
    ).reshape(-1, 2)
    rotation = rotation_from_euler_xyz_rad(*camera[10:])
    return np.concatenate([lens.rays(grid) * d @ rotation.T + camera[7:10] for d in distances])


def calibrate(camera, places, seed, sigma_px=0.02, sigma_mm=0.002, **changes):
    rng = np.random.default_rng(seed)
    true = places + rng.normal(0, sigma_mm, places.shape)
    n = len(places)
    outlines = circle_points(true, np.tile(NORMAL, (n, 1)), np.full(n, 5.0))
    pixels = project_with_derivatives(SENSOR, camera, outlines)[0]
    pixels = pixels + rng.normal(0, sigma_px, (n, 2))
    given = {
        "images": [str(i) for i in range(n)],
        "places": places,
        "pixels": pixels,
        "covariance_px2": np.tile(sigma_px**2 * np.eye(2), (n, 1, 1)),
        "sigma_xyz_mm": sigma_mm,
        "normal": NORMAL,
        "dot_diameter_mm": 5.0,
    }
    return calibrate_by_places(SENSOR, **(given | changes))


def test_analytic_derivatives_agree_with_differences():
    outlines = circle_points(places_before(TRUTH)[::7], np.tile(NORMAL, (13, 1)), np.full(13, 8.0))
    _, by_camera, by_outline = project_with_derivatives(SENSOR, TRUTH, outlines)
    steps = np.array([1e-4, 1e-3, 1e-3, 1e-12, 1e-19, 1e-11, 1e-11, *[1e-4] * 3, *[1e-6] * 3])
    for i, step in enumerate(np.diag(steps)):
        ahead = project_with_derivatives(SENSOR, TRUTH + step, outlines)[0]
        behind = project_with_derivatives(SENSOR, TRUTH - step, outlines)[0]
        numeric = (ahead - behind) / (2 * steps[i])
        # The derivative of the circle's weights is left out, as circle.py explains.
        scale = np.abs(numeric).max()
        assert np.abs(by_camera[:, :, i] - numeric).max() < 2e-3 * scale
    shift = np.array([1e-4, 0.0, 0.0])
    moved = project_with_derivatives(SENSOR, TRUTH, outlines + shift)[0]
    back = project_with_derivatives(SENSOR, TRUTH, outlines - shift)[0]
    numeric = (moved - back) / 2e-4
    assert np.abs(by_outline.sum(axis=1)[:, :, 0] - numeric).max() < 1e-3 * np.abs(numeric).max()


def test_many_circles_are_projected_as_one_by_one():
    places = places_before(TRUTH)[::7]
    outlines = circle_points(places, np.tile(NORMAL, (13, 1)), np.full(13, 8.0))
    rotation = rotation_from_euler_xyz_rad(*TRUTH[10:])
    wanted = project_circles(
        SENSOR.lens(TRUTH),
        (places - TRUTH[7:10]) @ rotation,
        np.tile(NORMAL @ rotation, (13, 1)),
        np.full(13, 8.0),
    )
    # The same circles, sampled at other angles.
    got = project_with_derivatives(SENSOR, TRUTH, outlines)[0]
    assert np.abs(got - wanted).max() < 2e-4
    pixels = SENSOR.lens(TRUTH).project(((outlines - TRUTH[7:10]) @ rotation).reshape(-1, 3))
    pixels = pixels.reshape(13, 8, 2)
    assert centre_weights_of_many(pixels) == pytest.approx(
        np.array([centre_weights(one) for one in pixels])
    )


@pytest.mark.parametrize("roll", [0.03, 1.6, 3.1, -2.0])
@pytest.mark.parametrize("focal_length", [4.0, 25.0])
def test_any_camera_is_found_from_nothing(roll, focal_length):
    camera = TRUTH.copy()
    camera[0], camera[12] = focal_length, roll
    scale = (6.189 / focal_length) ** 2
    camera[3:5] *= [scale, scale**2]
    camera[5:7] *= 6.189 / focal_length
    result = calibrate(camera, places_before(camera, (200, 330, 600)), seed=1)
    error = result.camera - camera
    error[10:] = (error[10:] + np.pi) % (2 * np.pi) - np.pi
    assert result.converged
    assert np.abs(error / np.sqrt(np.diag(result.covariance))).max() < 5


def test_squared_errors_over_the_covariance_are_as_promised():
    places = places_before(TRUTH)
    squares, sigma0 = [], []
    for seed in range(25):
        result = calibrate(TRUTH, places, seed)
        error = result.camera - TRUTH
        # sigma0 above 1 enlarges what is told: taken out again, for this law.
        covariance = result.covariance / max(result.sigma0, 1.0) ** 2
        squares.append(error @ np.linalg.solve(covariance, error))
        sigma0.append(result.sigma0**2)
    # Mean of 25 chi-squares of 13: 13 ± 1.02; within 4 sigma.
    assert 8.9 < np.mean(squares) < 17.1
    assert np.mean(sigma0) == pytest.approx(1.0, abs=0.1)


def test_a_wrong_image_is_left_out_and_named():
    places = places_before(TRUTH)
    good = calibrate(TRUTH, places, 3)
    pixels = np.array([o.pixel for o in good.observations])
    pixels[17] += [0.8, -0.5]
    result = calibrate(TRUTH, places, 3, pixels=pixels)
    assert [o.image for o in result.observations if o.reason] == ["17"]
    assert any("17" in words for words in result.findings)


def test_a_sixth_of_the_images_may_be_wrong_by_anything():
    places = places_before(TRUTH)
    good = calibrate(TRUTH, places, 3)
    rng = np.random.default_rng(8)
    wrong = rng.choice(len(places), len(places) // 6, replace=False)
    pixels = np.array([o.pixel for o in good.observations])
    pixels[wrong] += rng.normal(0, 300, (len(wrong), 2))
    result = calibrate(TRUTH, places, 3, pixels=pixels)
    assert {int(o.image) for o in result.observations if o.reason} == set(wrong.tolist())
    error = result.camera - TRUTH
    assert np.abs(error / np.sqrt(np.diag(result.covariance))).max() < 4.5


def test_a_camera_that_moved_is_refused_with_the_image_and_the_way():
    places = places_before(TRUTH)
    before = calibrate(TRUTH, places, 3)
    pixels = np.array([o.pixel for o in before.observations])
    moved = TRUTH.copy()
    moved[7] += 0.03
    pixels[50:] += (
        project_with_derivatives(SENSOR, moved, places[50:, None])[0]
        - project_with_derivatives(SENSOR, TRUTH, places[50:, None])[0]
    )
    with pytest.raises(MeasurementError, match=r"between image 49 and 50 .* about 0\.0[23]"):
        calibrate(TRUTH, places, 3, pixels=pixels)


@pytest.mark.parametrize("mirror", [[-1, 1, 1], [1, 1, -1]])
def test_places_that_are_a_mirror_image_are_told_as_such(mirror):
    places = places_before(TRUTH)
    pixels = np.array([o.pixel for o in calibrate(TRUTH, places, 3).observations])
    with pytest.raises(MeasurementError, match="mirror image"):
        calibrate(TRUTH, places * mirror, 3, pixels=pixels)


def test_promised_sigmas_that_are_far_too_large_are_a_finding():
    result = calibrate(TRUTH, places_before(TRUTH), 3, sigma_xyz_mm=0.02)
    assert any("sigma_xyz_mm or sigma_px is too large" in words for words in result.findings)


def test_images_and_places_that_are_mixed_up_are_refused():
    places = places_before(TRUTH)
    pixels = np.array([o.pixel for o in calibrate(TRUTH, places, 3).observations])
    with pytest.raises(MeasurementError):
        calibrate(TRUTH, places, 3, pixels=np.roll(pixels, 1, axis=0))


@pytest.mark.parametrize(
    ("places", "words"),
    [
        (places_before(TRUTH, (130, 300, 500), columns=2, rows=1), r"open: .*cl0_px .*k1_px2"),
        (
            places_before(TRUTH, (130, 250, 500), columns=1, rows=9),
            r"open: .*beta_rad \(with cl0_px",
        ),
        (
            places_before(TRUTH, (130, 250, 500), columns=2, rows=2),
            r"1 direction .*open: k1_px2 \(with focal_length_mm, k2_px4",
        ),
    ],
    ids=["two image points", "one column", "four image points"],
)
def test_what_a_set_leaves_open_is_named(places, words):
    places = np.concatenate([places] * 3)
    with pytest.raises(MeasurementError, match=words):
        calibrate(TRUTH, places, 5)


def test_one_plane_across_leaves_distance_and_focal_length_open_together():
    x, y = np.meshgrid(np.linspace(-110, 110, 7), np.linspace(-80, 80, 5))
    places = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -620.0)])
    with pytest.raises(MeasurementError, match=r"1 direction .*: z_mm \(with focal_length_mm\)"):
        calibrate(TRUTH, places, 5)


def test_too_few_images_are_told():
    with pytest.raises(MeasurementError, match="at least 8 images"):
        calibrate(TRUTH, places_before(TRUTH)[:5], 1)


def test_projection_uncertainty_grows_outside_what_was_covered():
    from omm_core.camera_calibration.result import projection_sigma_px

    result = calibrate(TRUTH, places_before(TRUTH, (300, 400, 500)), 2)
    near, inside = (
        projection_sigma_px(SENSOR, result.camera, result.covariance, d).max() for d in (60, 400)
    )
    assert near > inside
    assert dataclasses.replace(result).to_json_dict()["parameters"][0] == "focal_length_mm"


def test_two_halves_agree_unless_something_moved():
    places = places_before(TRUTH)
    good = calibrate(TRUTH, places, 6)
    assert good.extra["halves_chi2"] < 34.5
    assert not any("halves" in words for words in good.findings)
    pixels = np.array([o.pixel for o in good.observations])
    pixels[::2] += [0.3, 0.0]  # every second image is shifted: half of the set
    moved = calibrate(TRUTH, places, 6, pixels=pixels)
    assert any("halves" in words for words in moved.findings)


def test_a_lens_term_that_the_model_lacks_is_named_with_its_size():
    places = places_before(TRUTH)
    good = calibrate(TRUTH, places, 6)
    terms = {t["name"]: t for t in good.extra["further_terms"]}
    assert all(abs(t["w"]) < 4.5 for t in terms.values())
    assert not any("misses" in words for words in good.findings)
    pixels = np.array([o.pixel for o in good.observations])
    lens = SENSOR.lens(TRUTH)
    # An affinity of 1e-4 takes away 1e-4 of the measured offset, to first order.
    pixels[:, 0] -= 1e-4 * (pixels[:, 0] - lens.principal_point_px[0])
    result = calibrate(TRUTH, places, 6, pixels=pixels)
    affinity = next(t for t in result.extra["further_terms"] if t["name"] == "affinity")
    assert affinity["value"] == pytest.approx(1e-4, abs=5 * affinity["sigma"] + 1e-5)
    assert any("misses affinity" in words for words in result.findings)


def test_what_a_missing_term_does_to_a_measurement_is_what_the_calibrated_camera_does():
    places = places_before(TRUTH)
    middle = SENSOR.lens(TRUTH).principal_point_px

    def with_affinity(pixels):
        return pixels - [1e-4, 0.0] * (pixels - middle)

    good = calibrate(TRUTH, places, 6)
    pixels = with_affinity(np.array([o.pixel for o in good.observations]))
    result = calibrate(TRUTH, places, 6, pixels=pixels)
    affinity = next(t for t in result.extra["further_terms"] if t["name"] == "affinity")
    # The standard measurement as it really is, against the cameras of the same noise.
    seen, gain, _ = standard_measurement(SENSOR, TRUTH)
    rotation = rotation_from_euler_xyz_rad(*TRUTH[10:])
    points = SENSOR.lens(TRUTH).rays(seen) * 300.0 @ rotation.T + TRUTH[7:10]
    by_good, believed = (
        project_with_derivatives(SENSOR, camera, points[:, None])[0]
        for camera in (good.camera, result.camera)
    )
    error = gain @ (with_affinity(seen) - seen + by_good - believed).ravel()
    told = affinity["result_mm"] * 1e-4 / abs(affinity["value"])
    assert told == pytest.approx(np.abs(error[3:6]).max(), rel=0.05)
    assert told > 0.001


def test_a_ring_shaped_error_is_a_pattern_and_noise_is_none():
    places = places_before(TRUTH)
    good = calibrate(TRUTH, places, 6)
    assert {p["by"]: p["groups"] for p in good.extra["patterns"]}["ring"] == 6
    assert all(min(p["radial_p"], p["tangential_p"]) > 1e-4 for p in good.extra["patterns"])
    pixels = np.array([o.pixel for o in good.observations])
    offset = pixels - SENSOR.lens(TRUTH).principal_point_px
    radius = np.linalg.norm(offset, axis=1, keepdims=True)
    # A ripple that neither k1 nor k2 can follow.
    wavy = pixels + 0.06 * np.sin(radius / 90.0) * offset / radius
    result = calibrate(TRUTH, places, 6, pixels=wavy)
    assert any("radial residuals differ by ring" in words for words in result.findings)


def test_planes_are_told_apart_by_the_gaps_between_them():
    heights = np.array([0.0, 100.2, 0.3, 99.9, 50.0, 50.4])
    assert planes_of(heights).tolist() == [0, 2, 0, 2, 1, 1]
