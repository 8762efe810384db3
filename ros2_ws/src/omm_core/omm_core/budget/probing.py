"""Probed points against where the part's pose puts them.

The error of a touch is where the probe found the point minus where the pose says it is. All errors
of one pose move together: together they are judged by their joint covariance
``J Σ_θ Jᵀ + diag(σ²)``, each by its own diagonal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from omm_core.budget.sources import pose_jacobian
from omm_core.errors import InputError
from omm_core.files.probed import ProbedPoint
from omm_core.geometry import RigidTransform

Array = NDArray[np.float64]

COVERAGE = 2.0
_FAR_MM = 5.0  # no pose that a run finds is as wrong
SIGNIFICANCE = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbingCheck:
    """Errors of probed points; arrays are (N, 3), mm, machine X Y Z.

    Attributes
    ----------
    expected_mm, error_mm : array
        Where the pose puts the point; probed minus that.
    sigma_mm : array
        Standard uncertainty of the error: pose, probing, and what else was given.
    chi_square, p_value : float
        Of all errors together; NaN where the probing's σ is not known.
    motion : (6,) array or None
        Small rotations (rad) about machine X Y Z through the points' centre, and shift (mm), that
        fit the errors best; None below 3 points, or where all lie on a line.
    left_mm : (3,) array or None
        Root mean square of what remains then, by axis.
    """

    points: tuple[ProbedPoint, ...]
    expected_mm: Array
    error_mm: Array
    sigma_mm: Array
    chi_square: float
    p_value: float
    motion: Array | None
    left_mm: Array | None
    findings: tuple[str, ...]

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Return which errors lie inside U = 2 σ."""
        return np.abs(self.error_mm) <= COVERAGE * self.sigma_mm

    @property
    def share_inside(self) -> float:
        """Return the share of coordinates inside U."""
        return float(self.inside.mean())

    @property
    def believed(self) -> bool | None:
        """Whether the errors are as small as their covariance says, at 1 %; None if unknown."""
        return None if np.isnan(self.p_value) else bool(self.p_value >= SIGNIFICANCE)


def check_probing(
    points: Sequence[ProbedPoint],
    theta: Sequence[float],
    covariance: Array,
    *,
    extra_sigma_mm: Array | None = None,
) -> ProbingCheck:
    """Compare probed points with a pose.

    Parameters
    ----------
    theta : α, β, γ (rad), x, y, z (mm)
        In the machine's own coordinates, as the probe's readings are.
    covariance : (6, 6) or (7, 7) array
        Of θ.
    extra_sigma_mm : (N, 3) array, optional
        Standard uncertainty of the points besides pose and probing (u_out, expansion, …).

    Raises
    ------
    InputError
        Where a point has not been probed.
    """
    if any(point.machine_mm is None for point in points):
        raise InputError("Expected probed points, got some without machine coordinates.")
    at = np.array([point.part_mm for point in points])
    found = np.array([point.machine_mm for point in points])
    placed = RigidTransform.from_euler_xyz_rad(theta[0], theta[1], theta[2], theta[3:6])
    expected = placed @ at
    error = found - expected
    own = np.array([point.sigma_mm or 0.0 for point in points])[:, None] * np.ones(3)
    extra = np.zeros_like(own) if extra_sigma_mm is None else np.asarray(extra_sigma_mm)
    jacobian = pose_jacobian(theta, at).reshape(-1, 6)
    joint = jacobian @ np.asarray(covariance)[:6, :6] @ jacobian.T
    joint += np.diag((own**2 + extra**2).reshape(-1))
    chi_square, p_value = np.nan, np.nan
    if np.all(own**2 + extra**2 > 0.0):
        chi_square = float(error.reshape(-1) @ np.linalg.solve(joint, error.reshape(-1)))
        p_value = float(stats.chi2.sf(chi_square, error.size))
    motion, left = _motion(expected, error)
    return ProbingCheck(
        points=tuple(points),
        expected_mm=expected,
        error_mm=error,
        sigma_mm=np.sqrt(np.clip(np.diag(joint), 0.0, None)).reshape(-1, 3),
        chi_square=chi_square,
        p_value=p_value,
        motion=motion,
        left_mm=left,
        findings=_findings(points, error),
    )


def _findings(points: Sequence[ProbedPoint], error: Array) -> tuple[str, ...]:
    """Return what is wrong with the touches themselves, in words."""
    findings = []
    untold = sum(point.sigma_mm is None for point in points)
    if untold:
        findings.append(f"{untold} touches tell no sigma_mm: the probe counts as exact there")
    off = float(np.linalg.norm(np.median(error, axis=0)))
    if off > _FAR_MM:
        findings.append(
            f"the points lie {off:.4g} mm off all together: expected are machine coordinates (no"
            " work offset), in mm, of the touched place (not the spindle), the part as it lay then"
        )
    return tuple(findings)


def _motion(places: Array, error: Array) -> tuple[Array | None, Array | None]:
    """Return the small motion that fits the errors best, and the rms of what is left."""
    offsets = places - places.mean(axis=0)
    spread = np.linalg.svd(offsets, compute_uv=False)
    if len(spread) < 2 or len(places) < 3 or spread[1] < 1e-6 * max(spread[0], 1.0):
        return None, None
    design = np.concatenate([_turns(offsets), np.tile(np.eye(3), (len(places), 1, 1))], axis=2)
    flat = design.reshape(-1, 6)
    motion, *_ = np.linalg.lstsq(flat, error.reshape(-1), rcond=None)
    left = (error.reshape(-1) - flat @ motion).reshape(-1, 3)
    return motion, np.sqrt(np.mean(left**2, axis=0))


def _turns(offsets: Array) -> Array:
    """Return d(ω × p)/dω, (N, 3, 3)."""
    x, y, z = offsets.T
    none = np.zeros_like(x)
    rows = [[none, z, -y], [-z, none, x], [y, -x, none]]
    return np.moveaxis(np.array(rows), 2, 0)
