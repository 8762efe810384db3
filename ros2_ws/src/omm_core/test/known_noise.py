"""A solver that knows all noise: what no estimator can be better than. Plain numpy, nothing shared.

Generalised least squares with the true covariances of everything. The geometry's errors g at the
stops are unknowns with their own distribution; the absolute pose is θ, the own one θ - F ḡ, with F
the unweighted rigid fit over the targets of the mean error ḡ at the stops that saw each.
"""

from dataclasses import dataclass

import numpy as np
from reference_model import pose_of, predict


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownNoise:
    """What acts in a measurement (mm, px); ``geometry`` is one axis' covariance (S, S)."""

    image_sigma_px: float
    stop_sigma_mm: float
    geometry: np.ndarray
    target_sigma_mm: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownNoiseResult:
    """θ and covariance in the order of θ: absolute, and in the machine's own coordinates."""

    absolute: np.ndarray
    absolute_covariance: np.ndarray
    own: np.ndarray
    own_covariance: np.ndarray


def solve_knowing_all(
    near, X, image_of, target_of, spindles, calibration, measured_px, noise: KnownNoise
) -> KnownNoiseResult:
    """Return the best that can be known of a pose.

    Parameters
    ----------
    near : (7,) array
        θ to linearise at, within a fraction of a millimetre of the solution.
    X : (T, 3) array
        Targets, part frame.
    image_of, target_of : (N,) arrays of int
        Which stop and which target each centre belongs to.
    spindles : list of RigidTransform
        Commanded, one a stop.
    measured_px : (N, 2) array
    """
    predicted = [
        predict(calibration.lens, near, X[t], spindles[s], calibration.taper_T_camera)
        for s, t in zip(image_of, target_of)
    ]
    A = np.concatenate([jacobian for _, jacobian in predicted])
    y = (np.asarray(measured_px) - np.array([pixel for pixel, _ in predicted])).ravel()
    D = _spread(-A[:, 3:6], image_of, len(spindles))  # the spindle moves: the part moves back
    T = _spread(A[:, 3:6] @ pose_of(near).rotation, target_of, len(X))
    R = np.eye(len(y)) * noise.image_sigma_px**2
    R += noise.stop_sigma_mm**2 * D @ D.T + noise.target_sigma_mm**2 * T @ T.T
    W = np.linalg.inv(R)
    values, vectors = np.linalg.eigh(noise.geometry)
    K = np.kron(vectors * np.sqrt(np.maximum(values, 0.0)), np.eye(3))  # g = K z
    J = np.hstack([A, D @ K])
    prior = np.diag([0.0] * 7 + [1.0] * K.shape[1])
    # Scaled to equal diagonals, or radians beside millimetres would cost digits.
    normal = J.T @ W @ J + prior
    scale = 1.0 / np.sqrt(np.diag(normal))
    cofactor = np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale)
    found = cofactor @ (J.T @ W @ y)
    to_own = np.hstack([np.eye(7), -_rigid_fit(near, X, image_of, target_of, len(spindles)) @ K])
    return KnownNoiseResult(
        absolute=near + found[:7],
        absolute_covariance=cofactor[:7, :7],
        own=near + to_own @ found,
        own_covariance=to_own @ cofactor @ to_own.T,
    )


def _spread(derivatives, index, count):
    """Return (2N, 3 count): the three columns of each centre at its stop's or target's."""
    spread = np.zeros((len(derivatives), count, 3))
    spread[np.arange(len(derivatives)), np.repeat(index, 2)] = derivatives
    return spread.reshape(len(derivatives), 3 * count)


def _rigid_fit(near, X, image_of, target_of, stops):
    """Return dθ/dg (7, 3S) of the unweighted rigid fit; its row of γ_s is zero."""
    seen = np.unique(target_of)
    places = lambda theta: (pose_of(theta) @ X[seen]).ravel()  # noqa: E731
    steps = np.array([1e-6] * 3 + [1e-3] * 3)
    B = np.empty((3 * len(seen), 6))
    for k, step in enumerate(steps):
        up, down = near.copy(), near.copy()
        up[k], down[k] = near[k] + step, near[k] - step
        B[:, k] = (places(up) - places(down)) / (2 * step)
    mean = np.zeros((len(seen), stops))
    for row, target in enumerate(seen):
        of_target = np.asarray(image_of)[np.asarray(target_of) == target]
        np.add.at(mean[row], of_target, 1.0 / len(of_target))
    fit = np.zeros((7, 3 * stops))
    unit = np.array([1e3] * 3 + [1.0] * 3)
    fit[:6] = unit[:, None] * np.linalg.pinv(B * unit) @ np.kron(mean, np.eye(3))
    return fit
