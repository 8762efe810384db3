"""What each source of noise does to a problem that was made linear about its optimum.

With J the derivatives of the pixels by δ = (ω, d_0, γ_s) (kernels.py), in units of the detector's
own noise (whitened), and one column for each thing that may be wrong::

    y = J δ + e + D (s + f) + T t + B c        y = measured - computed

e the centres (variance 1), s the stops (each axis, each stop anew), f the smooth errors of the
geometry at the stops, t the targets' coordinates, c the calibration. The camera moved by d is the
part moved by -d: D = -d(pixel)/d(d_0), three columns for each of the S stops. Images that follow
each other and were taken from one place belong to one stop: the spindle did not move between them.

**Own coordinates.** A machine with geometry errors f has coordinates of its own, in which it would
go to meet the targets at X - f. Its rigid part, over the targets and at the stops that saw each,
is ``r f`` with r (7, 3S) = least squares of (ω, d_0) to the mean error at each target, γ_s
untouched. The pose in these is δ_own = δ - r f, so that ``y = J δ_own + (D + J r) f + …``: the same
problem with another effect of the geometry. A shift or turn common to all of f does then nothing,
which is why δ_own can be told and δ can not.

All covariances are kept as (u + m, u + m) matrices of (P y, K y), see grid_kernels.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.numerics.linear_algebra import inverse
from omm_core.part_pose.adjustment import Adjustment, by_calibration, predictions, whitening_of
from omm_core.part_pose.noise_kernels import smooth_covariance, split_rows
from omm_core.part_pose.observation import SolveOptions
from omm_core.part_pose.problem import Indices, Problem

Array = NDArray[np.float64]

_SAME_PLACE_MM = 0.005
_SAME_PLACE_RAD = 2e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseModel:
    """A linear problem of n = u + m rows, split into what tells δ and what tells of the noise.

    Attributes
    ----------
    problem, adjustment, unknowns
        What was made linear where; u = 7 or 6.
    whitening : (N, 2, 2) array
        Whitened = whitening @ px.
    split : (n, n) array
        (P, K): P J = 1, K J = 0, K Kᵀ = 1; of whitened rows.
    u_z : (n,) array
        split @ y.
    image, targets, calibration : (n, n) arrays
        Covariances of (u, z); ``image`` of the detector as it says.
    stop_of : (N,) array
        Which stop an observation was made at.
    places_mm : (S, 3) array
        Where the spindle was to stand at each stop.
    stops : (n, 3S) array
        Effect of an error of each stop on (u, z).
    rigid : (u, 3S) array
        r: the rigid part of errors at the stops.
    by_point : (N, 2, 3) array
        Whitened d(pixel)/d(d_0).
    """

    problem: Problem
    adjustment: Adjustment
    unknowns: int
    whitening: Array
    split: Array
    u_z: Array
    image: Array
    targets: Array
    calibration: Array
    stop_of: Indices
    places_mm: Array
    stops: Array
    rigid: Array
    by_point: Array

    @property
    def redundancy(self) -> int:
        """Return m, the degrees of freedom."""
        return len(self.u_z) - self.unknowns

    def stop_covariance(self) -> Array:
        """Return the covariance of (u, z) for stops of 1 mm, (n, n)."""
        return self.stops @ self.stops.T

    def geometry_covariances(self, lengths_mm: Array) -> tuple[Array, Array]:
        """Return the covariances of (u, z) for geometry errors of 1 mm: own, absolute.

        One (n, n) matrix for each length, (L, n, n); only what concerns u differs.
        """
        n, u, count = len(self.u_z), self.unknowns, len(self.places_mm)
        effect = np.empty((n + u, 3 * count))
        effect[:n] = self.stops
        effect[n:] = self.stops[:u] + self.rigid
        covariance = np.empty((len(lengths_mm), n + u, n + u))
        smooth_covariance(
            effect.reshape(n + u, count, 3), self.places_mm, np.asarray(lengths_mm), covariance
        )
        own = covariance[:, :n, :n].copy()
        own[:, :u, :u] = covariance[:, n:, n:]
        own[:, :u, u:] = covariance[:, n:, u:n]
        own[:, u:, :u] = covariance[:, u:n, n:]
        return own, np.ascontiguousarray(covariance[:, :n, :n])


def noise_model(problem: Problem, adjustment: Adjustment, options: SolveOptions) -> NoiseModel:
    """Return the linear problem about an optimum; raise ``LinAlgError`` where it has none."""
    u = options.unknowns
    pixels, J = predictions(problem, adjustment)
    whitening = whitening_of(problem)
    white = whitening @ J
    y = np.einsum("nij,nj->ni", whitening, problem.measured - pixels).ravel()
    split = _split(white[:, :, :u].reshape(-1, u))
    by_point = white[:, :, 3:6]
    stop_of, places_mm = find_stops(problem)
    count = len(places_mm)
    stops = np.zeros((len(problem), 2, count, 3))
    stops[np.arange(len(problem)), :, stop_of] = -by_point
    u_z = split @ y
    image = split @ split.T
    return NoiseModel(
        problem=problem,
        adjustment=adjustment,
        unknowns=u,
        whitening=whitening,
        split=split,
        u_z=u_z,
        image=image,
        targets=_of_targets(problem, adjustment, options, by_point, split),
        calibration=_of_calibration(problem, adjustment, options, whitening, split),
        stop_of=stop_of,
        places_mm=places_mm,
        stops=split @ stops.reshape(-1, 3 * count),
        rigid=rigid_part(problem, adjustment, stop_of)[:u],
        by_point=by_point,
    )


def find_stops(problem: Problem) -> tuple[Indices, Array]:
    """Return at which stop each observation was made (N,), and where the stops are (S, 3) mm.

    In the order of the stamps: a place that was left and come back to is another stop.
    """
    moved = np.linalg.norm(np.diff(problem.d_cnc, axis=0), axis=1) > _SAME_PLACE_MM
    turned = np.abs(np.diff(problem.R_cnc, axis=0)).max(axis=(1, 2), initial=0.0)
    new = np.concatenate([[True], moved | (turned > _SAME_PLACE_RAD)])
    of_images = np.cumsum(new) - 1
    used, stop_of = np.unique(of_images[problem.image_of], return_inverse=True)
    return stop_of.ravel(), problem.d_cnc[new][used]


def rigid_part(problem: Problem, adjustment: Adjustment, stop_of: Indices) -> Array:
    """Return r (7, 3S): (ω, d_0) of the unweighted rigid fit to the errors at the stops.

    The error of a target is the mean over the stops that saw it; γ_s has no part in it.
    """
    seen = np.unique(problem.target_of)
    count = int(stop_of.max()) + 1
    mean = np.zeros((len(seen), count))
    mean[np.searchsorted(seen, problem.target_of), stop_of] = 1.0
    mean /= mean.sum(axis=1, keepdims=True)
    arm = problem.points[seen, 0] @ adjustment.rotation.T
    size = max(float(np.sqrt(np.mean(arm**2))), 1e-9)
    design = np.zeros((len(seen), 3, 6))  # ω x a + d
    design[:, 0, 1], design[:, 0, 2] = arm[:, 2] / size, -arm[:, 1] / size
    design[:, 1, 2], design[:, 1, 0] = arm[:, 0] / size, -arm[:, 2] / size
    design[:, 2, 0], design[:, 2, 1] = arm[:, 1] / size, -arm[:, 0] / size
    design[:, :, 3:] = np.eye(3)
    flat = design.reshape(-1, 6)
    fit = inverse(flat.T @ flat) @ flat.T
    if not np.all(np.isfinite(fit)):
        raise np.linalg.LinAlgError("the targets do not determine a rigid motion")
    fit[:3] /= size
    rigid = np.zeros((7, 3 * count))
    rigid[:6] = np.einsum("ktj,ti->kij", fit.reshape(6, len(seen), 3), mean).reshape(6, -1)
    return rigid


def _split(design: Array) -> Array:
    """Return (P, K) of a design (n, u), (n, n)."""
    split = np.empty((len(design), len(design)))
    if len(design) < design.shape[1] or not split_rows(np.ascontiguousarray(design), split):
        raise np.linalg.LinAlgError("the observations do not determine all unknowns")
    return split


def _of_targets(
    problem: Problem, adjustment: Adjustment, options: SolveOptions, by_point: Array, split: Array
) -> Array:
    covariance = target_covariance(problem)
    if not options.use_target_sigma or not np.any(covariance):
        return np.zeros_like(split)
    targets = len(problem.target_ids)
    effect = np.zeros((len(problem), 2, targets, 3))
    effect[np.arange(len(problem)), :, problem.target_of] = by_point @ adjustment.rotation
    effect = split @ effect.reshape(-1, 3 * targets)
    return np.asarray(effect @ covariance @ effect.T)


def target_covariance(problem: Problem) -> Array:
    """Return the covariance of the problem's targets, (3T, 3T) mm², zeros where none is told."""
    place = {target.id: index for index, target in enumerate(problem.part.targets)}
    rows = [3 * place[target_id] + axis for target_id in problem.target_ids for axis in range(3)]
    return problem.part.target_covariance_mm2()[np.ix_(rows, rows)]


def _of_calibration(
    problem: Problem,
    adjustment: Adjustment,
    options: SolveOptions,
    whitening: Array,
    split: Array,
) -> Array:
    calibration = problem.calibration
    names, covariance = calibration.parameters, calibration.covariance
    sigma = np.sqrt(np.diag(covariance)) if len(names) else np.zeros(0)
    if not options.use_calibration_covariance or not np.any(sigma > 0.0):
        return np.zeros_like(split)
    uncertain = np.flatnonzero(sigma > 0.0)
    steps = {names[index]: float(sigma[index]) for index in uncertain}
    effect = split @ calibration_effect(problem, adjustment, whitening, steps)
    scale = np.outer(sigma[uncertain], sigma[uncertain])
    return np.asarray(effect @ (covariance[np.ix_(uncertain, uncertain)] / scale) @ effect.T)


def calibration_effect(
    problem: Problem, adjustment: Adjustment, whitening: Array, steps: dict[str, float]
) -> Array:
    """Return what one step of each parameter of the camera does to whitened pixels, (2N, P)."""
    names = tuple(steps)
    columns = [
        np.einsum("nij,nj->ni", whitening, difference).ravel()
        for difference in by_calibration(problem, adjustment, names, np.diag(list(steps.values())))
    ]
    return np.stack(columns, axis=1)
