"""The pose and the machine's noise, both from one run: a mixture over the machines there may be."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.grid_kernels import Matrices, Weighed, weigh
from omm_core.part_pose.machine_noise import NoiseGrid, noise_grid
from omm_core.part_pose.mixture_kernels import half_widths, moments, normalise
from omm_core.part_pose.noise_model import NoiseModel
from omm_core.part_pose.observation import SolveOptions
from omm_core.part_pose.problem import Problem

Array = NDArray[np.float64]

IMAGE = "image"
STOPS = "stops"
GEOMETRY = "geometry"
TARGETS = "targets"
CALIBRATION = "calibration"

COVERAGE = 0.9545
"""Share of errors that the expanded uncertainty holds."""
WIDER = 1.1
"""U by the half width of the mixture, where noise was estimated. No prior is right for every
machine: with this, those for whom it is least right have 93 % of errors inside, too
(docs/statistics.md)."""
_ALL_OF_THE_GRID = 5e8  # operations up to which all of it is computed
_COARSE = 3  # of so many levels one is tried first
_UNLIKELY = 12.0  # of ln weight below the best


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseStatement:
    """A pose in one kind of coordinates, all in the order of θ (rad, mm).

    Attributes
    ----------
    theta : (7,) array
    covariance : (7, 7) array
    expanded_uncertainty : (7,) array
        95.45 % of errors are smaller, whatever the distribution; see ``WIDER``.
    """

    theta: Array
    covariance: Array
    expanded_uncertainty: Array


NO_POSE = PoseStatement(
    theta=np.full(7, np.nan),
    covariance=np.full((7, 7), np.nan),
    expanded_uncertainty=np.full(7, np.nan),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """What a run says of the pose and of the machine.

    Attributes
    ----------
    model, grid
        What it is the posterior of.
    weight : (P,) array
        Probability of each machine of the grid.
    fit : (P,) array
        zᵀ C_zz⁻¹ z of each: about m where it explains the residuals.
    deltas, covariances : (P, 2, u), (P, 2, u, u) arrays
        Of the unknowns of kernels.py: own, absolute.
    log_evidence : float
    matrices : Matrices
    """

    model: NoiseModel
    grid: NoiseGrid
    weight: Array
    fit: Array
    deltas: Array
    covariances: Array
    log_evidence: float
    matrices: Matrices

    def statement(self, *, own: bool) -> PoseStatement:
        """Return the pose in the machine's own coordinates, or in ideal ones."""
        which = 0 if own else 1
        problem, adjustment = self.model.problem, self.model.adjustment
        to_theta = np.ascontiguousarray(
            adjustment.d_theta_d_local(problem.X0_mm)[:, : self.model.unknowns]
        )
        points = len(self.weight)
        mean, covariance, widths = np.empty(7), np.empty((7, 7)), np.empty(7)
        means, sigmas = np.zeros((points, 7)), np.zeros((points, 7))
        moments(
            self.weight, self.deltas[:, which], self.covariances[:, which], to_theta,
            mean, covariance, means, sigmas,
        )  # fmt: skip
        half_widths(self.weight, means, sigmas, mean, covariance, COVERAGE, widths)
        if {"stop_sigma_mm", "geometry_sigma_mm"} & set(self.grid.estimated):
            widths *= WIDER
        theta = adjustment.theta(problem.X0_mm) + mean
        theta[6] = np.pi - np.mod(np.pi - theta[6], 2 * np.pi)
        return PoseStatement(theta=theta, covariance=covariance, expanded_uncertainty=widths)

    def local_mean(self, *, own: bool) -> Array:
        """Return the mean of (ω, d_0, γ_s), (7,)."""
        mean = np.zeros(7)
        mean[: self.model.unknowns] = self.weight @ self.deltas[:, 0 if own else 1]
        return mean

    def local_covariance(self, *, own: bool) -> Array:
        """Return the covariance of (ω, d_0, γ_s), (7, 7)."""
        which, u = (0 if own else 1), self.model.unknowns
        deltas = self.deltas[:, which] - self.weight @ self.deltas[:, which]
        covariance = np.zeros((7, 7))
        covariance[:u, :u] = np.tensordot(self.weight, self.covariances[:, which], axes=1)
        covariance[:u, :u] += (deltas * self.weight[:, None]).T @ deltas
        return covariance

    @cached_property
    def components(self) -> dict[str, Array]:
        """Return the mean covariance of (u, z) in own coordinates by source, (n, n) each."""
        matrices = self.matrices
        grid, model = self.grid, self.model
        geometry = np.bincount(
            grid.length_index, weights=self.weight * grid.geometry_sigma_mm**2,
            minlength=len(matrices.C_own),
        )  # fmt: skip
        return {
            IMAGE: float(self.weight @ grid.image_scale**2) * matrices.C_image,
            STOPS: float(self.weight @ grid.stop_sigma_mm**2) * matrices.C_stop,
            GEOMETRY: np.tensordot(geometry, matrices.C_own, axes=1),
            TARGETS: model.targets,
            CALIBRATION: model.calibration,
        }

    def shares(self) -> dict[str, Array]:
        """Return the fraction of each parameter's variance by source, (7,) each; they sum to 1.

        Of the machine that the run speaks of on average; 0 where a parameter has no variance, and
        no source without any.
        """
        model, u = self.model, self.model.unknowns
        total = np.sum(list(self.components.values()), axis=0)
        gain = np.linalg.solve(total[u:, u:], total[u:, :u]).T
        to_theta = model.adjustment.d_theta_d_local(model.problem.X0_mm)[:, :u]
        combine = to_theta @ np.hstack([np.eye(u), -gain])
        variances = {
            name: np.einsum("ij,jk,ik->i", combine, C, combine)
            for name, C in self.components.items()
            if np.any(C)
        }
        whole = sum(variances.values())
        return {name: v / np.where(whole > 0.0, whole, 1.0) for name, v in variances.items()}


def detector_doubted(problem: Problem, options: SolveOptions) -> bool:
    """Return whether the centres may be worse than stated; see machine_noise.noise_grid."""
    return not options.trust_detector and bool(np.any(np.bincount(problem.image_of) > 1))


def noise_matrices(model: NoiseModel, grid: NoiseGrid) -> Matrices:
    """Return C_0, C_image, C_stop, C_own, C_absolute of grid_kernels.py."""
    own, absolute = model.geometry_covariances(grid.lengths_mm)
    known = model.targets + model.calibration
    return Matrices(
        C_0=known, C_image=model.image, C_stop=model.stop_covariance(), C_own=own,
        C_absolute=absolute,
    )  # fmt: skip


def diagonal_mm(problem: Problem) -> float:
    """Return the diagonal of the box of the stops."""
    places = problem.d_cnc[np.unique(problem.image_of)]
    return float(np.linalg.norm(np.ptp(places, axis=0)))


def posterior(model: NoiseModel, options: SolveOptions) -> Posterior:
    """Return what the data say of pose and machine."""
    doubted = detector_doubted(model.problem, options)
    grid = noise_grid(options, diagonal_mm(model.problem), scale_image=doubted)
    matrices = noise_matrices(model, grid)
    if len(grid) * model.redundancy**3 > _ALL_OF_THE_GRID:
        grid = grid.only(_likely_points(model, grid, matrices))
    weighed = _weighed(model, grid, matrices)
    weight = np.empty(len(grid))
    log_evidence = float(normalise(weighed.log_weight, weight))
    return Posterior(
        model=model, grid=grid, weight=weight, fit=weighed.fit, deltas=weighed.deltas,
        covariances=weighed.covariances, log_evidence=log_evidence, matrices=matrices,
    )  # fmt: skip


def _weighed(model: NoiseModel, grid: NoiseGrid, matrices: Matrices) -> Weighed:
    points, u = len(grid), model.unknowns
    weighed = Weighed(
        log_weight=np.empty(points), fit=np.empty(points),
        deltas=np.empty((points, 2, u)), covariances=np.empty((points, 2, u, u)),
    )  # fmt: skip
    weigh(matrices, model.u_z, u, grid.machines(), weighed)
    return weighed


def _likely_points(model: NoiseModel, grid: NoiseGrid, matrices: Matrices) -> NDArray[np.int64]:
    """Return the points of the grid that count, by climbing from a few of them.

    With many observations each point costs much, and all but few have no probability.
    """
    index_of = {tuple(at): index for index, at in enumerate(grid.coordinates.tolist())}
    wanted = np.flatnonzero(_coarse(grid)).tolist()
    log_weight = np.full(len(grid), -np.inf)
    known: set[int] = set()
    while wanted:
        points = np.array(sorted(wanted))
        log_weight[points] = _weighed(model, grid.only(points), matrices).log_weight
        known |= set(wanted)
        likely = [p for p in known if log_weight[p] > log_weight.max() - _UNLIKELY]
        beside = {
            index_of.get(tuple(at)) for p in likely for at in _neighbours(grid.coordinates[p])
        }
        wanted = [p for p in beside if p is not None and p not in known]
    return np.array(sorted(known))


def _coarse(grid: NoiseGrid) -> NDArray[np.bool_]:
    """Return which points are tried first, (P,): every third level of stops and geometry."""
    scale, stop, geometry, length = grid.coordinates.T
    of_stops = (stop % _COARSE == 1) | (stop.max() == 0)
    of_geometry = (geometry % _COARSE == 1) | (geometry == 0)
    of_length = (length == min(1, length.max())) | (geometry == 0) | (length.max() == 0)
    return np.asarray((scale == 0) & of_stops & of_geometry & of_length)


def _neighbours(coordinates: NDArray[np.int64]) -> list[list[int]]:
    """Return the coordinates of what is beside a point of the grid."""
    beside = [
        (coordinates + step * np.eye(4, dtype=int)[axis]).tolist()
        for axis in range(4)
        for step in (-1, 1)
    ]
    if coordinates[2] == 1:  # no geometry errors have no length
        beside.append([*coordinates[:2].tolist(), 0, 0])
    return beside
