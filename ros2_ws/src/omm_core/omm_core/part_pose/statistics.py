"""Is the solution believable? Tests and reliability of a photogrammetric adjustment.

Sources: Baarda 1968 (a testing procedure for use in geodetic networks), Förstner 1987 (reliability
analysis of parameter estimation), Teunissen 2006 (testing theory). An observation here is the two
coordinates of one centre. docs/statistics.md explains what the numbers mean to a person.

With whitened residuals v (variance 1 where the model holds) and ``Q_v,i`` the 2 x 2 block of their
covariance that belongs to observation i:

========================  ==================================================================
redundancy number         trace(Q_v,i) / 2: 1 fully checked by the others, 0 not at all
w-test                    T_i = v_iᵀ Q_v,i⁻¹ v_i, χ² with 2 degrees of freedom
smallest detectable       sqrt(λ_0 / μ), μ the smaller eigenvalue of Q_v,i; λ_0 from the test's
                          error probability and a power of 80 %
external reliability      what an error of just that size does to the unknowns: in their
                          standard deviations, sqrt(λ_0 (1 - μ) / μ), and in θ itself
========================  ==================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.observation import SolveOptions
from omm_core.part_pose.posterior import Posterior
from omm_core.part_pose.uncertainty import Propagation

Array = NDArray[np.float64]

POWER = 0.80
_UNCHECKED = 1e-6  # redundancy below which an observation is not checked by any other


@dataclass(frozen=True, kw_only=True, eq=False)
class Statistics:
    """Of one adjustment; arrays are in the order of the problem's observations.

    Attributes
    ----------
    sigma0 : float
        sqrt(cost / degrees of freedom): 1 where the weights are right; NaN without redundancy.
    degrees_of_freedom : int
    global_test, global_limit : float
        The cost, and what it stays below with probability 1 - significance.
    redundancy : (N,) array
    w_test : (N,) array
        sqrt(T_i), comparable to ``w_limit``; NaN where not checked.
    w_limit : float
    smallest_detectable_px, external_sigma : (N,) arrays
        Infinite where not checked.
    external_theta : (N, 7) array
        Change of θ (rad, mm) by the smallest detectable error.
    """

    sigma0: float
    degrees_of_freedom: int
    global_test: float
    global_limit: float
    redundancy: Array
    w_test: Array
    w_limit: float
    smallest_detectable_px: Array
    external_sigma: Array
    external_theta: Array

    @property
    def passed(self) -> bool:
        """Whether the residuals are as small as the weights promise."""
        return self.global_test <= self.global_limit


@lru_cache(maxsize=256)
def chi2_limit(degrees_of_freedom: int, significance: float) -> float:
    """Return what χ² exceeds with probability ``significance`` (0 without degrees of freedom)."""
    from scipy.special import chdtri

    return float(chdtri(degrees_of_freedom, significance)) if degrees_of_freedom > 0 else 0.0


@lru_cache(maxsize=16)
def noncentrality(significance: float) -> float:
    """Return λ_0: of an error that a test of 2 coordinates finds with probability POWER."""
    from scipy.special import chndtrinc

    return float(chndtrinc(chi2_limit(2, significance), 2, 1.0 - POWER))


def analyse_posterior(estimated: Posterior, options: SolveOptions) -> Statistics:
    """Return the statistics of a solution whose noise is correlated and was estimated.

    With V the mean covariance of all noise and ``W = Kᵀ (K V Kᵀ)⁻¹ K``, the redundancy is the trace
    of (W V) at an observation, and the rest as above with W_ii in the place of Q_v,i. The cost is
    the mean over the machines that there may be.
    """
    model = estimated.model
    u, count, m = model.unknowns, len(model.problem), model.redundancy
    degrees_of_freedom = m
    cost = float(estimated.weight @ estimated.fit)
    each = options.significance / count
    sigma0 = np.sqrt(cost / m) if m > 0 else np.nan
    C = np.asarray(sum(estimated.components.values()))
    K = model.split[u:]
    weighed = np.linalg.solve(C[u:, u:], K) if m else np.zeros_like(K)
    of_noise = np.hstack([np.linalg.inv(model.split)[:, :u], K.T])  # split⁻¹
    redundancy = np.einsum("mi,mi->i", weighed, C[u:] @ of_noise.T).reshape(count, 2)
    whitening = model.whitening
    blocks = np.einsum("mni,mnj->nij", K.reshape(m, count, 2), weighed.reshape(m, count, 2))
    W = np.swapaxes(whitening, 1, 2) @ blocks @ whitening
    misfit = (weighed.T @ model.u_z[u:]).reshape(count, 2)
    mu, axes = np.linalg.eigh(blocks)
    checked = mu[:, 0] > _UNCHECKED * np.maximum(mu[:, 1], 1e-300)
    smallest, direction = np.linalg.eigh(W)
    gain = model.split[:u] - C[:u, u:] @ weighed
    to_theta = model.adjustment.d_theta_d_local(model.problem.X0_mm)[:, :u]
    with np.errstate(invalid="ignore", divide="ignore"):
        along = np.einsum("nij,ni->nj", axes, misfit)
        w_test = np.sqrt(np.sum(along**2 / mu, axis=1))
        detectable = np.sqrt(noncentrality(each) / np.where(checked, smallest[:, 0], np.nan))
        error = np.einsum("nij,nj->ni", whitening, direction[:, :, 0]) * detectable[:, None]
        local = np.einsum("uni,ni->nu", gain.reshape(u, count, 2), error)
    sigma = local_sigma(estimated.local_covariance(own=True)[:u, :u], local)
    return Statistics(
        sigma0=float(sigma0),
        degrees_of_freedom=degrees_of_freedom,
        global_test=cost,
        global_limit=chi2_limit(degrees_of_freedom, options.significance),
        redundancy=np.clip(redundancy.mean(axis=1), 0.0, 1.0),
        w_test=np.where(checked, w_test, np.nan),
        w_limit=float(np.sqrt(chi2_limit(2, each))),
        smallest_detectable_px=np.where(checked, detectable, np.inf),
        external_sigma=np.where(checked, sigma, np.inf),
        external_theta=np.where(checked[:, None], local @ to_theta.T, np.inf),
    )


def local_sigma(covariance: Array, changes: Array) -> Array:
    """Return how many standard deviations changes (N, u) of the unknowns are, (N,)."""
    scale = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore"):
        white = np.linalg.solve(covariance / np.outer(scale, scale), (changes / scale).T)
        return np.asarray(np.sqrt(np.sum(white.T * (changes / scale), axis=1)))


def analyse(propagation: Propagation, d_theta_d_local: Array, options: SolveOptions) -> Statistics:
    """Return the statistics of a solution."""
    design, Q = propagation.design, propagation.cofactor
    u, count = options.unknowns, len(design)
    # Of many observations one is large by chance: the error probability is for all of them.
    each = options.significance / count
    gain = design @ Q  # (N, 2, u + m)
    covariance = np.eye(2) - gain @ np.swapaxes(design, 1, 2)
    mu, axes = np.linalg.eigh(covariance)
    checked = mu[:, 0] > _UNCHECKED
    worst = np.where(checked, mu[:, 0], np.nan)
    along = np.einsum("nij,ni->nj", axes, propagation.residuals)
    with np.errstate(invalid="ignore", divide="ignore"):
        w_test = np.sqrt(np.sum(along**2 / mu, axis=1))
        detectable = np.sqrt(noncentrality(each) / worst)
        direction = axes[:, :, 0] * detectable[:, None]
        in_pixels = np.linalg.solve(propagation.whitening, direction[:, :, None])[:, :, 0]
        local = np.einsum("nij,ni->nj", gain[:, :, :u], direction)
        external = detectable * np.sqrt(np.maximum(1.0 - worst, 0.0))
    degrees_of_freedom = 2 * count - u
    sigma0 = np.sqrt(propagation.cost / degrees_of_freedom) if degrees_of_freedom > 0 else np.nan
    return Statistics(
        sigma0=float(sigma0),
        degrees_of_freedom=degrees_of_freedom,
        global_test=propagation.cost,
        global_limit=chi2_limit(degrees_of_freedom, options.significance),
        redundancy=np.clip(mu.mean(axis=1), 0.0, 1.0),
        w_test=np.where(checked, w_test, np.nan),
        w_limit=float(np.sqrt(chi2_limit(2, each))),
        smallest_detectable_px=np.where(checked, np.hypot(*in_pixels.T), np.inf),
        external_sigma=np.where(checked, external, np.inf),
        external_theta=np.where(checked[:, None], local @ d_theta_d_local[:, :u].T, np.inf),
    )
