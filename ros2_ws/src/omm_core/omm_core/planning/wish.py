"""What uncertainty is wanted, and how far a plan is from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr, chndtrinc

from omm_core.errors import InputError
from omm_core.planning.prediction import Designs, local_state, stacked, turned
from omm_core.planning.scene import AssumedNoise, Scene

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

COVERAGE = 2.0
FOUND_SHARE = 0.95
"""How often a bump of the size that is called detectable is found."""
_BUMP_PRIOR_MM = 1.0  # the solver weighs "displaced by N(0, (1 mm)²)" against none


@dataclass(frozen=True, kw_only=True)
class PlanWish:
    """U (k = 2) that is wanted; None where it does not matter.

    Attributes
    ----------
    place_mm, angle_mm_per_m : float or None
        Of x, y, z each, and of α, β, γ each.
    point_mm : float or None
        Of the worst corner of the part's box: 2 √ of the largest eigenvalue of its covariance.
    bump_mm : float or None
        Displacement of any one target, in any direction, that is to be noticed.
    least_time : bool
        Whether it is machine time that is to be least, not the number of images.
    """

    place_mm: float | None = None
    angle_mm_per_m: float | None = None
    point_mm: float | None = None
    bump_mm: float | None = None
    least_time: bool = False

    def __post_init__(self) -> None:
        for name in ("place_mm", "angle_mm_per_m", "point_mm", "bump_mm"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InputError(f"Expected a wanted {name} above 0, got {value:g}.")

    @property
    def of_pose(self) -> bool:
        """Whether any U is wanted."""
        return any(v is not None for v in (self.place_mm, self.angle_mm_per_m, self.point_mm))


@dataclass(frozen=True, kw_only=True, eq=False)
class Yardstick:
    """What is read from a covariance of (ω, d_0, γ_s).

    Attributes
    ----------
    to_theta : (7, 7) array
        d(θ)/d(ω, d_0, γ_s).
    corners : (8, 3, 7) array
        d(place)/d(ω, d_0, γ_s) of the corners of the part's box.
    """

    wish: PlanWish
    to_theta: Array
    corners: Array

    @classmethod
    def of(cls, scene: Scene, wish: PlanWish) -> Yardstick:
        """Return the yardstick of a part at its place."""
        state, X0 = local_state(scene)
        corners = np.zeros((8, 3, 7))
        corners[:, range(3), range(3, 6)] = 1.0
        for i, corner in enumerate(scene.part.box_corners()):
            corners[i, :, :3] = turned(state.rotation @ (corner - X0))
        return cls(wish=wish, to_theta=state.d_theta_d_local(X0), corners=corners)

    def theta_covariance(self, covariance: Array) -> Array:
        """Return the covariances of θ, (..., 7, 7)."""
        return np.asarray(self.to_theta @ covariance @ self.to_theta.T)

    def expanded(self, covariance: Array) -> Array:
        """Return U of θ, (..., 7), rad and mm."""
        theta = self.theta_covariance(covariance)
        return np.asarray(COVERAGE * np.sqrt(np.diagonal(theta, axis1=-2, axis2=-1)))

    def corner_U_mm(self, covariance: Array) -> Array:
        """Return U of each corner of the box, (..., 8)."""
        places = self.corners @ covariance[..., None, :, :] @ np.swapaxes(self.corners, 1, 2)
        return np.asarray(COVERAGE * np.sqrt(np.linalg.eigvalsh(places)[..., -1]))

    def score(self, covariance: Array) -> Array:
        """Return how many times too large U is, (...,); without a wish U in mm over the box."""
        wish = self.wish
        ratios = []
        U = self.expanded(covariance)
        if wish.place_mm is not None:
            ratios.append(U[..., 3:6].max(axis=-1) / wish.place_mm)
        if wish.angle_mm_per_m is not None:
            ratios.append(1e3 * U[..., :3].max(axis=-1) / wish.angle_mm_per_m)
        if wish.point_mm is not None:
            ratios.append(self.corner_U_mm(covariance).max(axis=-1) / wish.point_mm)
        if not ratios:
            return self.corner_U_mm(covariance).max(axis=-1)
        return np.asarray(np.max(ratios, axis=0))


def smallest_bumps_mm(designs: Designs, noise: AssumedNoise, stops: Indices) -> dict[int, float]:
    """Return for each target seen (its row) the smallest displacement that is surely noticed.

    In the worst direction, found in 95 % of measurements by the solver's own test: the Bayes
    factor of "this target is displaced by N(0, (1 mm)²)" against none, which is above 1 where
    ``Σ z² > Σ ln(1 + e)`` with e the eigenvalues of the displacement's information and z² of
    non-central χ² distribution. Infinite where a displacement cannot be told from another pose.
    """
    A, V = (block[0] for block in stacked(designs, noise, stops[None]))
    weight = np.linalg.inv(V)
    scale = 1.0 / np.maximum(np.linalg.norm(A, axis=0), 1e-12)
    WA = weight @ (A * scale)
    normal = (A * scale).T @ WA + 1e-12 * np.eye(7)
    projected = weight - WA @ np.linalg.solve(normal, WA.T)
    target = np.repeat(designs.target[stops].ravel(), 2)
    bumps = {}
    for row in sorted(set(target.tolist()) - {-1}):
        T = np.where((target == row)[:, None], A[:, 3:6], 0.0)
        information = np.maximum(np.linalg.eigvalsh(T.T @ projected @ T), 0.0)
        if information[0] < 1e-6 * information[-1] or information[0] <= 0.0:
            bumps[row] = np.inf
            continue
        threshold = float(np.sum(np.log1p(information * _BUMP_PRIOR_MM**2)))
        bumps[row] = float(np.sqrt(_noncentrality(threshold) / information[0]))
    return bumps


def _noncentrality(threshold: float) -> float:
    """Return λ for which χ²(3, λ) is above a threshold in FOUND_SHARE of all cases."""
    missed = 1.0 - FOUND_SHARE
    if chndtr(threshold, 3.0, 0.0) < missed:
        return 0.0
    return float(chndtrinc(threshold, 3.0, missed))
