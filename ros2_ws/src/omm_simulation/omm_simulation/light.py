"""How bright a surface appears: the ring light about the lens, and the lens' own fall-off."""

import numba
import numpy as np

from omm_simulation.metal import GRID_STEP_PX
from omm_simulation.rays import Floats, LensNumbers, ray_of_pixel

_LAMPS = 6


@numba.njit(cache=True)
def _irradiance(x: float, y: float, z: float, normal: Floats, ring_radius_mm: float) -> float:
    """Light of a ring of lamps in the camera's plane at a point in `camera_optical`."""
    total = 0.0
    for lamp in range(_LAMPS):
        angle = 2.0 * np.pi * lamp / _LAMPS
        to_x = ring_radius_mm * np.cos(angle) - x
        to_y = ring_radius_mm * np.sin(angle) - y
        r2 = to_x * to_x + to_y * to_y + z * z
        incidence = normal[0] * to_x + normal[1] * to_y - normal[2] * z
        total += max(0.0, incidence) / (r2 * np.sqrt(r2))
    return total / _LAMPS


@numba.njit(cache=True)
def light_grid(
    lens: LensNumbers, normal: Floats, point_mm: Floats, nominal_distance_mm: float,
    ring_radius_mm: float, vignetting: float, rows: int, cols: int,
) -> Floats:  # fmt: skip
    """Light on the plate as the camera sees it, on a grid of every GRID_STEP_PX-th pixel.

    Relative to a surface that faces the camera at the nominal distance, on the axis; 0 where a
    ray misses the plate.

    Parameters
    ----------
    normal, point_mm : ndarray, shape (3,)
        Of the plate, in `camera_optical`.
    vignetting : float
        Exponent of cos θ.
    """
    facing = np.array([0.0, 0.0, -1.0])
    nominal = _irradiance(0.0, 0.0, nominal_distance_mm, facing, ring_radius_mm)
    light = np.zeros((rows, cols))
    for j in range(rows):
        for i in range(cols):
            x, y = ray_of_pixel(lens, float(i * GRID_STEP_PX), float(j * GRID_STEP_PX))
            towards = normal[0] * x + normal[1] * y + normal[2]
            depth = (normal @ point_mm) / towards if towards < 0.0 else -1.0
            if depth <= 0.0:
                continue
            seen = _irradiance(x * depth, y * depth, depth, normal, ring_radius_mm)
            light[j, i] = seen / nominal * (1.0 + x * x + y * y) ** (-vignetting / 2.0)
    return light


@numba.njit(cache=True)
def light_at(light, first_col: int, first_row: int, out) -> None:  # type: ignore[no-untyped-def]
    """The grid's light at each pixel of a window of the image; `out` (H, W), the border repeated.

    Parameters
    ----------
    light : ndarray of float32, shape (rows, cols)
    first_col, first_row : int
        Where the window begins; may lie outside of the image.
    """
    for row in range(out.shape[0]):
        y = min(max((first_row + row) / GRID_STEP_PX, 0.0), light.shape[0] - 1.001)
        j = int(y)
        fy = y - j
        for col in range(out.shape[1]):
            x = min(max((first_col + col) / GRID_STEP_PX, 0.0), light.shape[1] - 1.001)
            i = int(x)
            fx = x - i
            above = (1.0 - fx) * light[j, i] + fx * light[j, i + 1]
            below = (1.0 - fx) * light[j + 1, i] + fx * light[j + 1, i + 1]
            out[row, col] = (1.0 - fy) * above + fy * below
