"""Images with one known target, for the tests of detection and centring."""

from __future__ import annotations

import numpy as np

from omm_core.targets import TargetFamily
from omm_simulation.target_image import affine_plane, disc_coverage, target_coverage


def target_image(
    rng,
    *,
    target_id=42,
    name="metashape12",
    diameter_px=30.0,
    tilt_deg=0.0,
    blur_px=0.8,
    contrast_dn=150.0,
    slope=0.0,
    bright=True,
    chip=None,
):
    """An image (float, no noise) and the true centre; `chip` = (x, y, radius) in dot radii."""
    family = TargetFamily.by_name(name)
    radius = 0.5 * diameter_px
    size = 2 * int((family.ring_outer_ratio + 0.8) * radius + 8)
    centre = 0.5 * size + rng.uniform(-0.5, 0.5, 2)
    plane = affine_plane(
        centre_px=tuple(centre),
        radius_px=radius,
        tilt_rad=np.radians(tilt_deg),
        axis_rad=rng.uniform(0, np.pi),
    )
    window = (0, 0, size, size)
    cover = target_coverage(
        code=family.code_of(target_id),
        family=family,
        dot_radius_mm=1.0,
        plane_of_pixel=plane,
        window=window,
        blur_px=blur_px,
        phase_rad=rng.uniform(0, 6.28),
    )
    if chip:
        x, y, r = chip
        cover *= 1.0 - disc_coverage(
            centre_mm=(x, y), radius_mm=r, plane_of_pixel=plane, window=window, blur_px=blur_px
        )
    rows, cols = np.mgrid[:size, :size]
    angle = rng.uniform(0, 6.28)
    along = (cols - centre[0]) * np.cos(angle) + (rows - centre[1]) * np.sin(angle)
    light = 1.0 + slope * along / diameter_px
    share = cover if bright else 1.0 - cover
    return light * (15.0 + contrast_dn * share), centre


def as_seen(rng, image, *, read_dn=2.0, gain=0.0, dtype=np.uint8):
    """Add read and shot noise and digitise (16 bit: 256 grey values for each of 8 bit)."""
    noisy = image + rng.normal(size=image.shape) * np.sqrt(read_dn**2 + gain * image)
    if dtype == np.uint16:
        return np.clip(np.rint(256.0 * noisy), 0, 65535).astype(np.uint16)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
