"""Covariance of the solution, from everything that is known to be uncertain.

Besides the centres, three things are observed rather than known: where the machine stood at each
image, the coordinates of the targets, and the calibration. Each becomes additional unknowns s
with their own (co)variance as observations, as in a bundle adjustment. With F Fᵀ the covariance
and s = F z, z is a vector of unknowns that are observed as 0 with variance 1::

    minimise  Σ (l - f(θ) - B z)ᵀ W (l - f(θ) - B z) + zᵀ z,      B = df/ds F

What is common to all images (the calibration) does not average out: it is one z for all. The
inverse Q of the normal matrix of (θ, z) holds the covariance of θ. It is the sum of the shares of
each source (:attr:`Propagation.shares`): with A_l the part of the normal matrix that comes from
the centres, ``Q_θ. A_l Q_.θ`` is theirs, and ``Q_θs Q_sθ`` that of each s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.numerics.linear_algebra import inverse
from omm_core.part_pose.adjustment import (
    Adjustment,
    by_calibration,
    moved,
    predictions,
    whitening_of,
)
from omm_core.part_pose.observation import SolveOptions
from omm_core.part_pose.problem import Problem

Array = NDArray[np.float64]

IMAGE = "image"
MACHINE = "machine"
TARGETS = "targets"
CALIBRATION = "calibration"

_STEPS = 10
_CONVERGED_SIGMA = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Propagation:
    """A solution with its covariance, in the unknowns of kernels.py (``u`` = 7, or 6 in 6D).

    Attributes
    ----------
    adjustment : Adjustment
        With all sources weighed in; the same as before where only the centres are uncertain.
    cost : float
        Weighted sum of squares of residuals and of z.
    covariance : (7, 7) array
        Of (ω, d_0, γ_s); the row and column of a given γ_s are zero.
    shares : dict of (7, 7) arrays
        By source; they sum to ``covariance``.
    raw_residuals_px : (N, 2) array
        Computed minus measured, as a person sees them.
    residuals : (N, 2) array
        After z, whitened: of variance 1 where the model holds.
    whitening : (N, 2, 2) array
        Whitened = whitening @ px.
    design : (N, 2, u + m) array
        Whitened derivatives by (θ, z).
    cofactor : (u + m, u + m) array
        Q.
    """

    adjustment: Adjustment
    cost: float
    covariance: Array
    shares: dict[str, Array]
    raw_residuals_px: Array
    residuals: Array
    whitening: Array
    design: Array
    cofactor: Array


def propagate(problem: Problem, adjustment: Adjustment, options: SolveOptions) -> Propagation:
    """Return the solution with its covariance; raise ``LinAlgError`` where it has none."""
    u = options.unknowns
    whitening = whitening_of(problem)
    groups, B = _nuisance(problem, adjustment, options)
    z = np.zeros(B.shape[2])
    for _ in range(_STEPS):
        pixels, J = predictions(problem, adjustment)
        design = whitening @ np.concatenate([J[:, :, :u], B], axis=2)
        residuals = np.einsum("nij,nj->ni", whitening, pixels + B @ z - problem.measured)
        from_centres, cofactor = _invert(design, u)
        gradient = np.einsum("nij,ni->j", design, residuals)
        gradient[u:] += z
        step = -cofactor @ gradient
        if not len(z) or np.sqrt(abs(step @ gradient)) < _CONVERGED_SIGMA:
            break
        adjustment = moved(adjustment, step[:u])
        z = z + step[u:]
    covariance = np.zeros((7, 7))
    covariance[:u, :u] = cofactor[:u, :u]
    shares = {IMAGE: cofactor[:u] @ from_centres @ cofactor[:, :u]}
    for name, group in groups.items():
        gain = cofactor[:u, u:][:, group]
        shares[name] = gain @ gain.T
    return Propagation(
        adjustment=adjustment,
        cost=float(np.sum(residuals**2) + z @ z),
        covariance=covariance,
        shares={name: np.pad(share, (0, 7 - u)) for name, share in shares.items()},
        raw_residuals_px=pixels - problem.measured,
        residuals=residuals,
        whitening=whitening,
        design=design,
        cofactor=cofactor,
    )


def _invert(design: Array, u: int) -> tuple[Array, Array]:
    """Return the normal matrix of the centres alone, and the inverse of that of (θ, z)."""
    flat = design.reshape(-1, design.shape[2])
    from_centres = flat.T @ flat
    normal = from_centres.copy()
    normal[range(u, len(normal)), range(u, len(normal))] += 1.0
    cofactor = inverse(normal)
    if not np.all(np.isfinite(cofactor)):
        raise np.linalg.LinAlgError("the observations do not determine all unknowns")
    return from_centres, cofactor


def _nuisance(
    problem: Problem, adjustment: Adjustment, options: SolveOptions
) -> tuple[dict[str, slice], Array]:
    """Return where each source's z are, and B (N, 2, m)."""
    _, J = predictions(problem, adjustment)
    blocks: dict[str, Array] = {}
    if options.stop_sigma_mm:
        # The camera moving by d is the part moving by -d.
        blocks[MACHINE] = _spread(
            -J[:, :, 3:6] * options.stop_sigma_mm, problem.image_of, len(problem.stamps_ns)
        )
    sigmas = _target_sigmas(problem)
    if options.use_target_sigma and np.any(sigmas > 0.0):
        by_target = J[:, :, 3:6] @ adjustment.rotation * sigmas[problem.target_of][:, None, :]
        blocks[TARGETS] = _spread(by_target, problem.target_of, len(problem.target_ids))
    if options.use_calibration_covariance and len(problem.calibration.parameters):
        blocks[CALIBRATION] = _by_calibration(problem, adjustment)
    groups, first = {}, 0
    for name, block in blocks.items():
        groups[name] = slice(first, first + block.shape[2])
        first += block.shape[2]
    return groups, np.concatenate([np.zeros((len(problem), 2, 0)), *blocks.values()], axis=2)


def _spread(derivatives: Array, index: NDArray[np.int64], count: int) -> Array:
    """Return (N, 2, 3 count): the three columns of each observation at its image's or target's."""
    spread = np.zeros((len(index), 2, count, 3))
    spread[np.arange(len(index)), :, index] = derivatives
    return spread.reshape(len(index), 2, 3 * count)


def _target_sigmas(problem: Problem) -> Array:
    by_id = {target.id: target.sigma_xyz_mm for target in problem.part.targets}
    told = [by_id[target_id] for target_id in problem.target_ids]
    return np.array([np.zeros(3) if sigma is None else sigma for sigma in told]).reshape(-1, 3)


def _by_calibration(problem: Problem, adjustment: Adjustment) -> Array:
    """Return d(pixel)/dz of the calibration, (N, 2, P), by central differences of one sigma."""
    calibration = problem.calibration
    names, covariance = calibration.parameters, calibration.covariance
    sigma = np.sqrt(np.diag(covariance))
    uncertain = sigma > 0.0
    correlation = covariance[np.ix_(uncertain, uncertain)] / np.outer(
        sigma[uncertain], sigma[uncertain]
    )
    eigenvalues, vectors = np.linalg.eigh(correlation)
    factor = np.zeros((len(names), int(uncertain.sum())))
    factor[uncertain] = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    steps = np.diag(sigma)[uncertain]
    columns = list(by_calibration(problem, adjustment, names, steps))
    return np.asarray(np.stack(columns, axis=2) @ factor[uncertain])
