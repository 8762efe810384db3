"""From light to grey values: photon noise, read noise and quantisation.

The noise of pixel i of a frame is a function of the frame's seed and of i alone: a counter-based
generator (splitmix64), four draws of 16 bits from each number, turned into normal deviates by a
table of the inverse normal distribution. No state, no order, and a few nanoseconds a pixel.
"""

from functools import lru_cache
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from omm_simulation.scenario import SimulatedImaging


@lru_cache(maxsize=1)
def _normal_quantiles() -> NDArray[np.float32]:
    """Return normal deviates at the middles of 65536 equal slices of probability.

    Their variance is exactly 1.
    """
    from scipy.special import ndtri

    deviates = ndtri((np.arange(65536) + 0.5) / 65536)
    return (deviates / deviates.std()).astype(np.float32)


@numba.njit(cache=True, nogil=True)
def _mix(counter: np.uint64) -> np.uint64:
    z = counter * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@numba.njit(cache=True, nogil=True, fastmath=True)
def _expose(
    ideal: Any, seed: np.uint64, black: np.float32, read_variance: np.float32,
    dn_per_electron: np.float32, full_scale: np.float32, quantiles: Any, out: Any,
) -> None:  # fmt: skip
    pixels, noisy = ideal.reshape(-1), out.reshape(-1)
    half, zero = np.float32(0.5), np.float32(0.0)
    start = _mix(seed)
    block = 256
    normal = np.empty(block, np.float32)
    for first in range(0, len(pixels), block):
        n = min(block, len(pixels) - first)
        for k in range(0, n, 4):
            bits = _mix(start + np.uint64(first + k))
            for j in range(4):
                normal[k + j] = quantiles[(bits >> np.uint64(16 * j)) & np.uint64(0xFFFF)]
        for k in range(n):
            signal = pixels[first + k]
            variance = read_variance + max(signal - black, zero) * dn_per_electron
            grey = signal + np.sqrt(variance) * normal[k] + half
            noisy[first + k] = np.int32(min(max(grey, zero), full_scale))


def expose(
    ideal_dn: NDArray[np.float32], imaging: SimulatedImaging, *, seed: int, bits: int
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the grey values of one exposure.

    Parameters
    ----------
    ideal_dn : ndarray of float32, shape (H, W)
        What the pixels would say without noise and quantisation, on the 8-bit scale.
    imaging : SimulatedImaging
    seed : int
        Of this frame's noise.
    bits : int
        8, or 16: the same light and noise, on a scale 256 times as fine.
    """
    scale = np.float32(1.0 if bits == 8 else 256.0)
    out = np.empty(ideal_dn.shape, np.uint8 if bits == 8 else np.uint16)
    _expose(
        ideal_dn if bits == 8 else ideal_dn * scale,
        np.uint64(seed),
        np.float32(imaging.black_dn) * scale,
        np.float32(imaging.read_noise_dn**2) * scale * scale,
        scale / np.float32(imaging.electrons_per_dn),
        np.float32(2**bits - 1),
        _normal_quantiles(),
        out,
    )
    return out


def quantise(ideal_dn: NDArray[np.float32], *, bits: int) -> NDArray[Any]:
    """Return the grey values without noise."""
    scale, top = (1.0, 255.0) if bits == 8 else (256.0, 65535.0)
    grey = np.clip(np.floor(ideal_dn * np.float32(scale) + np.float32(0.5)), 0.0, top)
    return grey.astype(np.uint8 if bits == 8 else np.uint16)
