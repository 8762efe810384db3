"""How bright a surface appears: the ring light about the lens, and the lens' own fall-off."""

import numba
import numpy as np

from omm_simulation.metal import GRID_STEP_PX
from omm_simulation.rays import Floats, LensNumbers, ray_of_pixel

_LAMPS = 6


@numba.njit(cache=True, nogil=True)
def _irradiance(x: float, y: float, z: float, normal: Floats, ring_radius_mm: float) -> float:
    """Return the light of a ring of lamps in the camera's plane at a point in `camera_optical`."""
    total = 0.0
    for lamp in range(_LAMPS):
        angle = 2.0 * np.pi * lamp / _LAMPS
        to_x = ring_radius_mm * np.cos(angle) - x
        to_y = ring_radius_mm * np.sin(angle) - y
        r2 = to_x * to_x + to_y * to_y + z * z
        incidence = normal[0] * to_x + normal[1] * to_y - normal[2] * z
        total += max(0.0, incidence) / (r2 * np.sqrt(r2))
    return total / _LAMPS


@numba.njit(cache=True, nogil=True)
def light_grid(
    lens: LensNumbers, normal: Floats, point_mm: Floats, nominal_distance_mm: float,
    ring_radius_mm: float, vignetting: float, first_col: int, first_row: int, rows: int, cols: int,
) -> Floats:  # fmt: skip
    """Return the light on a plane as the camera sees it, on a grid of every GRID_STEP_PX-th pixel.

    Relative to a surface that faces the camera at the nominal distance, on the axis; 0 where a
    ray misses the plane.

    Parameters
    ----------
    normal, point_mm : ndarray, shape (3,)
        Of the plane, in `camera_optical`.
    vignetting : float
        Exponent of cos θ.
    first_col, first_row : int
        Pixel of the grid's first point; may lie outside of the image.
    rows, cols : int
        Size of the grid.
    """
    facing = np.array([0.0, 0.0, -1.0])
    nominal = _irradiance(0.0, 0.0, nominal_distance_mm, facing, ring_radius_mm)
    light = np.zeros((rows, cols))
    for j in range(rows):
        for i in range(cols):
            col, row = first_col + i * GRID_STEP_PX, first_row + j * GRID_STEP_PX
            x, y = ray_of_pixel(lens, float(col), float(row))
            towards = normal[0] * x + normal[1] * y + normal[2]
            depth = (normal @ point_mm) / towards if towards < 0.0 else -1.0
            if depth <= 0.0:
                continue
            seen = _irradiance(x * depth, y * depth, depth, normal, ring_radius_mm)
            light[j, i] = seen / nominal * (1.0 + x * x + y * y) ** (-vignetting / 2.0)
    return light


@numba.njit(cache=True, nogil=True)
def light_between(grid, out) -> None:  # type: ignore[no-untyped-def]
    """Return the light at each pixel from a grid of it; `out` (H, W) begins where the grid does."""
    for row in range(out.shape[0]):
        j = row // GRID_STEP_PX
        fy = (row - j * GRID_STEP_PX) / GRID_STEP_PX
        for col in range(out.shape[1]):
            i = col // GRID_STEP_PX
            fx = (col - i * GRID_STEP_PX) / GRID_STEP_PX
            above = (1.0 - fx) * grid[j, i] + fx * grid[j, i + 1]
            below = (1.0 - fx) * grid[j + 1, i] + fx * grid[j + 1, i + 1]
            out[row, col] = (1.0 - fy) * above + fy * below
