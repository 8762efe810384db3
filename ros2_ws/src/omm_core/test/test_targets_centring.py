"""The centre's error is the Cramér–Rao bound's, and its covariance says so."""

import math

import numpy as np
import pytest
from target_scenes import as_seen, target_image

from omm_core.targets import TargetFamily, detect_targets

FAMILY = TargetFamily.by_name("metashape12")


def _errors(draws, **scene):
    rng = np.random.default_rng(1)
    errors, normalised = [], []
    for _ in range(draws):
        image, centre = target_image(rng, target_id=int(rng.integers(1, 162)), **scene)
        (target,) = detect_targets(as_seen(rng, image), FAMILY).targets
        error = target.center_px - centre
        errors.append(error)
        normalised.append(error @ np.linalg.solve(target.covariance_px2, error))
    return np.array(errors), np.array(normalised)


def _bound(diameter_px, blur_px=0.8, contrast_dn=150.0, read_dn=2.0):
    """Bound of the centre of a blurred disc: only its edge tells, and by symmetry nothing else.

    Derivative of the image by the centre's col: contrast · φ(d / s) / s · cos t; integrated over
    all pixels (densely sampled): contrast² / (2 sqrt(pi) s) · ∫ cos² t r dt.
    """
    s = math.hypot(blur_px, math.sqrt(1 / 12))
    information = contrast_dn**2 / (2 * math.sqrt(math.pi) * s) * math.pi * diameter_px / 2
    return math.sqrt((read_dn**2 + 1 / 12) / information)


def test_closed_form_of_the_bound_is_the_published_one():
    # 20 px, contrast 150 DN, blur 0.8 px, noise 2 DN: 4.13e-3 px; 60 px: 2.40e-3 px.
    assert _bound(20.0) == pytest.approx(4.13e-3, rel=0.03)
    assert _bound(60.0) == pytest.approx(2.40e-3, rel=0.03)


@pytest.mark.parametrize("diameter_px", [12.0, 20.0, 60.0])
def test_error_is_near_the_bound(diameter_px):
    draws = 60
    errors, normalised = _errors(draws, diameter_px=diameter_px)
    ratio = np.sqrt(np.mean(errors**2)) / _bound(diameter_px)
    # The scatter of an RMS over 2 · draws values is 1 / sqrt(4 · draws); three of these.
    assert ratio < 1.10 + 3 / math.sqrt(4 * draws)
    assert 2.0 - 3 * 2 / math.sqrt(draws) < normalised.mean() < 2.0 + 3 * 2 / math.sqrt(draws)


@pytest.mark.parametrize("scene", [{"tilt_deg": 60.0}, {"slope": 0.1}, {"contrast_dn": 400.0}])
def test_no_bias_from_tilt_light_or_saturation(scene):
    errors, _ = _errors(40, diameter_px=40.0, **scene)
    scatter = errors.std(axis=0) / math.sqrt(len(errors))
    assert (np.abs(errors.mean(axis=0)) < 0.002 + 3 * scatter).all()
    assert np.abs(errors).max() < 0.03


@pytest.mark.parametrize("name", ["aicon12", "metashape12"])
def test_light_is_not_taken_from_edges_of_a_small_tilted_ring(name):
    # Without noise what is left is the method's own: an outline that is off by a tenth of a pixel
    # makes the ring's edges look like light that falls off.
    rng, errors = np.random.default_rng(3), []
    for _ in range(40):
        image, centre = target_image(rng, name=name, diameter_px=13.0, tilt_deg=50.0)
        seen = as_seen(rng, image, read_dn=0.05, dtype=np.uint16)
        (target,) = detect_targets(seen, TargetFamily.by_name(name)).targets
        errors.append(target.center_px - centre)
    assert np.sqrt(np.mean(np.square(errors))) < 0.0015


@pytest.mark.parametrize("contrast_dn", [250.0, 400.0])
def test_small_blurred_dots_are_centred_saturated_or_not(contrast_dn):
    # Level, size and blur of what is saturated can hardly be told apart, but its centre can.
    rng, draws, normalised = np.random.default_rng(3), 40, []
    for _ in range(draws):
        scene = {"diameter_px": 14.0, "tilt_deg": 40.0, "blur_px": 1.6, "contrast_dn": contrast_dn}
        target_id = int(rng.integers(1, 140))
        image, centre = target_image(rng, name="aicon12", target_id=target_id, **scene)
        for target in detect_targets(as_seen(rng, image), TargetFamily.by_name("aicon12")).targets:
            error = target.center_px - centre
            normalised.append(error @ np.linalg.solve(target.covariance_px2, error))
    assert len(normalised) >= 0.9 * draws
    assert np.mean(normalised) < 2.0 + 3 * 2 / math.sqrt(draws)
