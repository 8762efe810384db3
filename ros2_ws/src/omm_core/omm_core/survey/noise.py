"""What the detector's standard deviations are worth: variance components by kind of target.

The variance of a ray is ``scale² · detector's + floor²``, both estimated from the residuals v of
their kind and their redundancy numbers r: ``E[v²] = r (scale² σ² + floor²)``, by weighted least
squares (Förstner 1979; Teunissen and Amiri-Simkooei 2008). On clean pictures the floor vanishes;
on photographs it is most of it: the film's grain and the sensor's pixels are not alike.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FEWEST = 30  # redundancy below which a kind has one component only
_TURNS = 20
_LEAST = 0.05  # smallest scale


@dataclass(frozen=True, kw_only=True)
class Component:
    """Of one kind: variance of a ray = scale² · the detector's + floor_px²."""

    scale: float = 1.0
    floor_px: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RayNoise:
    """By kind of target."""

    of: dict[str, Component] = field(default_factory=dict)

    def covariance(self, detector: Array, kinds: NDArray[np.str_]) -> Array:
        """Return what the rays' covariances (M, 2, 2) px² are."""
        scaled = np.array(detector)
        for kind, component in self.of.items():
            rays = kinds == kind
            scaled[rays] = scaled[rays] * component.scale**2 + np.eye(2) * component.floor_px**2
        return scaled

    def sigma0(self, detector: Array, kinds: NDArray[np.str_], used: NDArray[np.bool_]) -> float:
        """Return how many times the detector's the standard deviation of all rays is (rms)."""
        now = self.covariance(detector, kinds)[used]
        ratio = np.einsum("mij,mji->m", now, np.linalg.inv(detector[used])) / 2.0
        return float(np.sqrt(ratio.mean()))


def estimated(
    residuals: Array, redundancy: Array, detector: Array, kinds: NDArray[np.str_], before: RayNoise
) -> RayNoise:
    """Return the noise that residuals (M, 2) and their redundancy numbers show.

    Parameters
    ----------
    residuals, redundancy : (M, 2) arrays
        Of the rays that take part only.
    detector : (M, 2, 2) array
    before : RayNoise
        Kept for a kind of which too little is seen.
    """
    of = dict(before.of)
    for kind in np.unique(kinds):
        rays = kinds == kind
        squares = residuals[rays].ravel() ** 2
        free = redundancy[rays].ravel()
        variances = np.einsum("mii->mi", detector[rays]).ravel()
        if free.sum() >= 4.0:
            of[str(kind)] = _component(squares, free, variances)
    return RayNoise(of=of)


def _component(squares: Array, free: Array, variances: Array) -> Component:
    """Fit scale² and floor² to squares = free (scale² variances + floor²)."""
    scale2, floor2 = float(squares.sum() / (free * variances).sum()), 0.0
    if free.sum() < _FEWEST:
        return Component(scale=max(np.sqrt(scale2), _LEAST))
    for _ in range(_TURNS):
        model = scale2 * variances + floor2
        weight = 1.0 / np.maximum(free, 0.05) / model**2  # 1 / variance of squares, times free
        columns = np.stack([variances, np.ones_like(variances)], axis=1) * free[:, None]
        normal = columns.T @ (columns * weight[:, None])
        right = columns.T @ (squares * weight)
        unit = 1.0 / np.sqrt(np.diag(normal))
        try:
            found = unit * np.linalg.solve(normal * np.outer(unit, unit), right * unit)
        except np.linalg.LinAlgError:
            break
        if found[0] <= _LEAST**2:
            found = np.array(
                [
                    _LEAST**2,
                    max(right[1] / normal[1, 1] - _LEAST**2 * normal[0, 1] / normal[1, 1], 0.0),
                ]
            )
        if found[1] < 0.0:
            found = np.array([right[0] / normal[0, 0], 0.0])
        done = np.allclose(found, [scale2, floor2], rtol=1e-4, atol=0.0)
        scale2, floor2 = float(found[0]), float(found[1])
        if done:
            break
    return Component(scale=float(np.sqrt(scale2)), floor_px=float(np.sqrt(floor2)))
