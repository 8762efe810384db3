"""What surrounds the targets: a machined plate with marks, holes and numbers stamped into it.

The surface is a tile that repeats, mixed with a second one of another period so that the eye (and
a detector) finds no repetition. Reflectances are relative to the mean of the metal.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numba
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from omm_simulation.rays import Floats, LensNumbers, ray_of_pixel

TILE_PX = 2048
COARSE_MM_PER_PX, FINE_MM_PER_PX = 0.131, 0.047

# The plate's coordinates and the light are smooth over the image: computed every so many pixels,
# interpolated between.
GRID_STEP_PX = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class Metal:
    """Reflectance of the plate; both tiles (TILE_PX, TILE_PX), their product has mean 1."""

    coarse: NDArray[np.float32]
    fine: NDArray[np.float32]


@lru_cache(maxsize=2)
def machined_plate(seed: int, contrast: float) -> Metal:
    """Return a plate: milling marks and clutter at the scale of a target, a brushed grain below it.

    Parameters
    ----------
    seed : int
    contrast : float
        Standard deviation over mean of marks and grain; the clutter goes with it. 0 is a plate
        without any.
    """
    rng = np.random.default_rng(seed)
    coarse = _noise(rng, sigma_px=(6.0, 6.0)) + 0.7 * _milling_marks(rng)
    fine = _noise(rng, sigma_px=(14.0, 2.2))
    # Of the contrast, half of the variance each.
    share = contrast / 2**0.5
    return Metal(
        coarse=_positive(1.0 + share * coarse / coarse.std() + 2.8 * contrast * _clutter(rng)),
        fine=_positive(1.0 + share * fine / fine.std()),
    )


def _positive(reflectance: NDArray[np.float32]) -> NDArray[np.float32]:
    kept = np.clip(reflectance, 0.05, 6.0)
    return (kept / kept.mean()).astype(np.float32)


def _noise(rng: np.random.Generator, *, sigma_px: tuple[float, float]) -> NDArray[np.float32]:
    """Return periodic Gaussian noise, smooth over so many pixels in x and y."""
    white = rng.standard_normal((TILE_PX, TILE_PX), dtype=np.float32)
    along_x, along_y = (
        np.exp(-2 * np.pi**2 * (sigma * frequency) ** 2).astype(np.float32)
        for sigma, frequency in zip(
            sigma_px, (scipy.fft.rfftfreq(TILE_PX), scipy.fft.fftfreq(TILE_PX))
        )
    )
    spectrum = scipy.fft.rfft2(white) * along_x[None, :] * along_y[:, None]
    smooth = scipy.fft.irfft2(spectrum, s=white.shape)
    return np.asarray(smooth / smooth.std(), dtype=np.float32)


def _milling_marks(rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the arcs that a face mill leaves, pass beside pass."""
    index = np.arange(TILE_PX, dtype=np.float32)
    period_px, radius_px = TILE_PX / 4, 0.8 * TILE_PX
    row_in_pass = (index % period_px) - period_px / 2
    arc_px = np.sqrt(radius_px**2 - row_in_pass**2)
    turns = (index[None, :] + arc_px[:, None]) * np.float32(64 / TILE_PX)
    marks = np.sin(np.float32(2 * np.pi) * turns)
    return marks * (1.0 + 0.5 * _noise(rng, sigma_px=(40.0, 40.0)))


def _clutter(rng: np.random.Generator) -> NDArray[np.float32]:
    """Return scratches, drilled holes and stamped numbers, added to the reflectance."""
    drawn = np.zeros((TILE_PX, TILE_PX), np.float32)

    def anywhere() -> tuple[int, int]:
        col, row = rng.integers(100, TILE_PX - 100, 2)
        return int(col), int(row)

    for _ in range(40):
        start, length, angle = anywhere(), rng.uniform(60, 500), rng.uniform(0, np.pi)
        end = (int(start[0] + length * np.cos(angle)), int(start[1] + length * np.sin(angle)))
        cv2.line(drawn, start, end, float(rng.uniform(-0.5, 1.5)), 1, cv2.LINE_AA)
    for _ in range(6):
        centre, radius = anywhere(), int(rng.integers(15, 45))
        cv2.circle(drawn, centre, radius, -0.8, -1)
        cv2.circle(drawn, centre, radius + 3, float(rng.uniform(0.4, 1.2)), 2)
    for _ in range(5):
        centre, radius = anywhere(), int(rng.integers(20, 90))
        first, extent = rng.uniform(0, 360), rng.uniform(40, 300)
        cv2.ellipse(
            drawn, centre, (radius, radius), 0.0, first, first + extent,
            float(rng.uniform(0.5, 1.5)), int(rng.integers(2, 9)),
        )  # fmt: skip
    stamped = np.zeros(drawn.shape, np.uint8)  # OpenCV 5 writes into nothing but bytes
    for _ in range(5):
        text = str(rng.integers(1000, 99999))
        cv2.putText(stamped, text, anywhere(), cv2.FONT_HERSHEY_SIMPLEX, 2.2, 255, 5)
    drawn += stamped * np.float32(0.9 / 255)
    # The plate's y points up, the rows of the drawing down.
    return np.asarray(np.flipud(cv2.GaussianBlur(drawn, (0, 0), 1.0)), dtype=np.float32)


@numba.njit(cache=True, nogil=True)
def plate_grid(lens: LensNumbers, homography: Floats, rows: int, cols: int) -> Floats:
    """Return where the grid's points see the plate, in mm, shape (2, rows, cols)."""
    seen = np.empty((2, rows, cols))
    for j in range(rows):
        for i in range(cols):
            x, y = ray_of_pixel(lens, float(i * GRID_STEP_PX), float(j * GRID_STEP_PX))
            depth = homography[2, 0] * x + homography[2, 1] * y + homography[2, 2]
            for k in range(2):
                along = homography[k, 0] * x + homography[k, 1] * y + homography[k, 2]
                seen[k, j, i] = along / depth
    return seen


@numba.njit(cache=True, nogil=True, fastmath=True)
def render_plate(  # type: ignore[no-untyped-def]
    grid_mm, light, coarse, fine, black_dn, mean_dn, out
) -> None:
    """Return the plate's grey values: both tiles (nearest pixel) times the light.

    Parameters
    ----------
    grid_mm : ndarray, shape (2, rows, cols)
        From `plate_grid`.
    light : ndarray of float32, shape (rows, cols)
        On the same grid, 1 where a surface shows its nominal grey value.
    coarse, fine : ndarray of float32
        See `Metal`.
    black_dn, mean_dn : float32
        Grey value without light, and of the metal in nominal light above it.
    out : ndarray of float32, shape (H, W)
    """
    height, width = out.shape
    mask = TILE_PX - 1
    # 16 bits of fraction; positive all over, for the tile repeats.
    fixed = 65536.0
    offset = 1 << 40
    for row in range(height):
        j = row // GRID_STEP_PX
        f = (row - j * GRID_STEP_PX) / GRID_STEP_PX
        for i in range((width + GRID_STEP_PX - 1) // GRID_STEP_PX):
            u0 = (1.0 - f) * grid_mm[0, j, i] + f * grid_mm[0, j + 1, i]
            u1 = (1.0 - f) * grid_mm[0, j, i + 1] + f * grid_mm[0, j + 1, i + 1]
            v0 = (1.0 - f) * grid_mm[1, j, i] + f * grid_mm[1, j + 1, i]
            v1 = (1.0 - f) * grid_mm[1, j, i + 1] + f * grid_mm[1, j + 1, i + 1]
            l0 = np.float32((1.0 - f) * light[j, i] + f * light[j + 1, i]) * mean_dn
            l1 = np.float32((1.0 - f) * light[j, i + 1] + f * light[j + 1, i + 1]) * mean_dn
            dl = (l1 - l0) / np.float32(GRID_STEP_PX)
            ca, cb = (
                np.int64(u0 / COARSE_MM_PER_PX * fixed) + offset,
                np.int64(v0 / COARSE_MM_PER_PX * fixed) + offset,
            )
            dca = np.int64((u1 - u0) / (COARSE_MM_PER_PX * GRID_STEP_PX) * fixed)
            dcb = np.int64((v1 - v0) / (COARSE_MM_PER_PX * GRID_STEP_PX) * fixed)
            fa, fb = (
                np.int64(u0 / FINE_MM_PER_PX * fixed) + offset,
                np.int64(v0 / FINE_MM_PER_PX * fixed) + offset,
            )
            dfa = np.int64((u1 - u0) / (FINE_MM_PER_PX * GRID_STEP_PX) * fixed)
            dfb = np.int64((v1 - v0) / (FINE_MM_PER_PX * GRID_STEP_PX) * fixed)
            first = i * GRID_STEP_PX
            for k in range(min(GRID_STEP_PX, width - first)):
                reflectance = (
                    coarse[(cb >> 16) & mask, (ca >> 16) & mask]
                    * fine[(fb >> 16) & mask, (fa >> 16) & mask]
                )
                out[row, first + k] = black_dn + (l0 + dl * np.float32(k)) * reflectance
                ca += dca
                cb += dcb
                fa += dfa
                fb += dfb
