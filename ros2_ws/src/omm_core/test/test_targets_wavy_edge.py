"""An edge that is not an ellipse's moves the centre, and the covariance says by how much."""

import cv2
import numpy as np

from omm_core.targets import detect_targets
from omm_core.targets.coded.families import TargetFamily

FAMILY = TargetFamily.by_name("aicon14")
RADIUS_PX, FINE, SIDE = 8.0, 7, 64
HARMONICS = np.arange(1, 7)


def wavy_target(rng, target_id, wave_px):
    """A target whose edge errs by smooth waves, alike for all harmonics up to 6, and its centre."""
    centre = 32.0 + rng.uniform(-0.5, 0.5, 2)
    rows, cols = np.mgrid[: SIDE * FINE, : SIDE * FINE]
    x, y = (cols + 0.5) / FINE - 0.5 - centre[0], (rows + 0.5) / FINE - 0.5 - centre[1]
    angles, radii = np.arctan2(y, x), np.hypot(x, y) / RADIUS_PX
    waves = rng.normal(size=(2, len(HARMONICS))) * wave_px / RADIUS_PX
    edge = 1.0 + sum(
        a * np.cos(k * angles) + b * np.sin(k * angles)
        for k, a, b in zip(HARMONICS, *waves, strict=True)
    )
    code = FAMILY.code_of(target_id)
    sector = np.floor((angles / (2 * np.pi) + 0.5) * FAMILY.bits).astype(int) % FAMILY.bits
    bits = np.array([code >> (FAMILY.bits - 1 - b) & 1 for b in range(FAMILY.bits)])
    ring = (radii > 2.0) & (radii < 3.0) & (bits[sector] == 1)
    fine = np.where((radii < edge) | ring, 110.0, 15.0).astype(np.float32)
    image = cv2.resize(fine, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    noisy = image + rng.normal(0.0, 0.6, image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), centre


def squares(wave_px, draws=60):
    """Squared errors over the covariances, and the mean variance (px²)."""
    rng = np.random.default_rng(4)
    normalised, variances = [], []
    for k in range(draws):
        image, centre = wavy_target(rng, 1 + 7 * k, wave_px)
        (target,) = detect_targets(image, FAMILY).targets
        off = target.center_px - centre
        normalised.append(off @ np.linalg.solve(target.covariance_px2, off) / 2.0)
        variances.append(0.5 * np.trace(target.covariance_px2))
    return np.array(normalised), float(np.mean(variances))


def test_the_residuals_along_the_edge_tell_of_the_centre():
    _, noise_px2 = squares(0.0)
    wavy, wide_px2 = squares(0.04)
    assert 0.5 < np.median(wavy) / np.log(2.0) < 2.5  # χ² of two coordinates: its median is ln 2
    assert wide_px2 > 20.0 * noise_px2
