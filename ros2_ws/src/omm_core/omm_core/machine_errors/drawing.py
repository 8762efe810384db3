"""Errors that are drawn by chance: at each stop, over the working volume, of targets and camera.

The geometry of a machine (straightness, squareness, pitch, scale) makes errors that differ little
between places that lie close together. Each axis' error is a normal field of its own::

    cov(e(a), e(b)) = σ² exp(-|a - b|² / 2 l²)

with a, b commanded places of the spindle and l the length over which the errors vary.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omm_core.errors import InputError
from omm_core.files.part import Part
from omm_core.imaging.calibration import CameraCalibration

Array = NDArray[np.float64]

WAVES = 512


def geometry_covariance(places_mm: ArrayLike, sigma_mm: float, length_mm: float) -> Array:
    """Return the covariance of one axis' geometry error between places.

    Parameters
    ----------
    places_mm : (S, 3) array
        Commanded positions of the spindle, machine frame.
    sigma_mm, length_mm : float
        σ and l.

    Returns
    -------
    (S, S) array, mm²
    """
    _check(sigma_mm, length_mm)
    places = np.asarray(places_mm, dtype=float)
    squared = np.sum((places[:, None] - places[None]) ** 2, axis=2)
    return np.asarray(sigma_mm**2 * np.exp(-0.5 * squared / length_mm**2))


def draw_geometry(
    random: np.random.Generator, places_mm: ArrayLike, sigma_mm: float, length_mm: float
) -> Array:
    """Return one draw of the geometry's errors at places, (S, 3), exactly normal.

    At these places only: :class:`GeometryField` is a machine that has errors everywhere.
    """
    covariance = geometry_covariance(places_mm, sigma_mm, length_mm)
    values, vectors = np.linalg.eigh(covariance)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(factor @ random.normal(size=(len(covariance), 3)))


@dataclass(frozen=True, kw_only=True, eq=False)
class GeometryField:
    """The geometry's errors of one machine, at every place of it.

    A sum of plane waves whose wave vectors are drawn from the spectrum of the covariance
    (Rahimi and Recht, Random features for large-scale kernel machines, 2007): over machines, the
    covariance is exact; within one, places differ by what so many waves leave (4 %).

    Attributes
    ----------
    waves : (M, 3) array
        Wave vectors, rad/mm.
    amplitudes_mm : (2, M, 3) array
        Of cosine and sine, for each axis.
    """

    waves: Array
    amplitudes_mm: Array

    @classmethod
    def draw(cls, random: np.random.Generator, sigma_mm: float, length_mm: float) -> GeometryField:
        """Draw a machine."""
        _check(sigma_mm, length_mm)
        waves = random.normal(0.0, 1.0 / length_mm, (WAVES, 3))
        amplitudes = random.normal(0.0, 1.0, (2, WAVES, 3)) * sigma_mm / np.sqrt(WAVES)
        return cls(waves=waves, amplitudes_mm=amplitudes)

    def __call__(self, places_mm: ArrayLike) -> Array:
        """Return true minus commanded at places (..., 3), mm, in the machine's axes."""
        phase = np.asarray(places_mm, dtype=float) @ self.waves.T
        return np.asarray(
            np.cos(phase) @ self.amplitudes_mm[0] + np.sin(phase) @ self.amplitudes_mm[1]
        )


def draw_stop_noise(random: np.random.Generator, stops: int, sigma_mm: float) -> Array:
    """Return what each stop is off by itself, (S, 3): the machine's repeatability."""
    return random.normal(0.0, 1.0, (stops, 3)) * sigma_mm


def draw_targets(random: np.random.Generator, part: Part) -> Part:
    """Return the part with its targets where they may really be, by what its file declares."""
    drawn = _draw_normal(random, part.target_covariance_mm2()).reshape(-1, 3)
    return replace(
        part,
        targets=tuple(replace(t, xyz_mm=t.xyz_mm + error) for t, error in zip(part.targets, drawn)),
    )


def draw_calibration(
    random: np.random.Generator, calibration: CameraCalibration
) -> CameraCalibration:
    """Return the camera as it may really be, by the covariance that its file declares."""
    names = calibration.parameters
    if not names:
        return calibration
    error = _draw_normal(random, calibration.covariance)
    return calibration.with_parameters(names, calibration.parameter_values(names) + error)


def _draw_normal(random: np.random.Generator, covariance: Array) -> Array:
    """Draw from a covariance whose units differ as radians and millimetres do."""
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(
        scale * (vectors @ (np.sqrt(np.maximum(values, 0.0)) * random.normal(size=len(sigma))))
    )


def _check(sigma_mm: float, length_mm: float) -> None:
    if not (np.isfinite(sigma_mm) and sigma_mm >= 0.0 and length_mm > 0.0):
        raise InputError(
            f"Expected a geometry with sigma >= 0 mm and length > 0 mm, got {sigma_mm} and"
            f" {length_mm}."
        )
