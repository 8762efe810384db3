"""Small drawn photographs of coded targets on stands, as an ordinary camera takes them by hand."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.targets import TargetFamily
from omm_simulation.target_image import target_coverage

Array = NDArray[np.float64]

FAMILY = TargetFamily.by_name("aicon12")
WIDTH, HEIGHT, FOCAL_PX = 800, 600, 1000.0
NUMBERS = (1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 12, 13)
DOT_RADIUS_MM = 5.0
DARK, BRIGHT = 25.0, 170.0


def targets_mm() -> Array:
    """Return the targets' places (12, 3): a grid, on stands of four heights, all facing z."""
    x, y = np.meshgrid(np.arange(4) * 90.0, np.arange(3) * 90.0)
    heights = 40.0 * ((np.arange(12) * 7) % 4)
    return np.column_stack([x.ravel() - 135.0, y.ravel() - 90.0, heights])


def bar_mm(first: int, second: int) -> float:
    """Return the distance of two targets, by number."""
    places = dict(zip(NUMBERS, targets_mm(), strict=True))
    return float(np.linalg.norm(places[first] - places[second]))


@functools.cache
def photograph(index: int, of: int = 8) -> NDArray[np.uint8]:
    """Return photograph ``index`` out of ``of`` all around, turned about its axis by quarters."""
    azimuth = 2.0 * np.pi * index / of
    tilt = np.radians(20.0 + 15.0 * (index % 2))
    back = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
    centre = np.array([0.0, 0.0, 60.0]) + 620.0 * back
    across = np.cross([0.0, 0.0, 1.0], back)
    across /= np.linalg.norm(across)
    axes = np.array([across, -np.cross(back, across), -back])  # rows: right, down, forward
    rolled = Rotation.from_euler("z", 90.0 * (index % 4), degrees=True).as_matrix() @ axes
    image = np.full((HEIGHT, WIDTH), DARK)
    for number, place in zip(NUMBERS, targets_mm(), strict=True):
        _draw(image, number, place, rolled, centre)
    noisy = image + np.random.default_rng(index).normal(0.0, 1.0, image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def _draw(image: Array, number: int, place: Array, axes: Array, centre: Array) -> None:
    """Draw a target that faces z where the camera sees it, if it does so wholly."""
    to_pixel = np.array(
        [[FOCAL_PX, 0, WIDTH / 2 - 0.5], [0, FOCAL_PX, HEIGHT / 2 - 0.5], [0, 0, 1]]
    )
    homography = to_pixel @ np.column_stack([axes[:, 0], axes[:, 1], axes @ (place - centre)])
    inverse = np.linalg.inv(homography)

    def plane(cols: Array, rows: Array) -> tuple[Array, Array]:
        x, y, w = np.einsum("ij,j...->i...", inverse, np.stack([cols, rows, np.ones_like(cols)]))
        return x / w, y / w

    reach = DOT_RADIUS_MM * FAMILY.ring_outer_ratio * 1.1
    corners = homography @ np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [1 / reach] * 4]) * reach
    cols, rows = corners[:2] / corners[2]
    left, top = int(cols.min()), int(rows.min())
    width, height = int(cols.max()) + 1 - left, int(rows.max()) + 1 - top
    if min(left, top) < 0 or left + width > WIDTH or top + height > HEIGHT:
        return
    cover = target_coverage(
        code=FAMILY.code_of(number), family=FAMILY, dot_radius_mm=DOT_RADIUS_MM,
        plane_of_pixel=plane, window=(left, top, width, height), blur_px=0.8,
    )  # fmt: skip
    image[top : top + height, left : left + width] += (BRIGHT - DARK) * cover
