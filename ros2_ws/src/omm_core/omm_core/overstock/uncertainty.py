"""How well overstock, smallest margin and the targets' places are known.

Noise is drawn from the survey's covariance (the full one, where there is one), and the points
are placed anew, each face taken as its tangent plane at the best placement: motions are as
small as the noise. Told overstock minus the measured surface's under the same placement is the
error; its smallest over a face is told too low, for the smallest of noisy values is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.files.points import SurveyPoint, SurveyPoints
from omm_core.overstock.placement import place_evenly
from omm_core.overstock.placement_state import Placement
from omm_core.overstock.problem import Problem, Settled

Array = NDArray[np.float64]
DRAWS = 200
DRAWS_OF_MANY = 60
MANY = 1000
SEED = 1
COVERAGE = 0.9545
RADIUS_MM = 1.0
RADIUS_SIGMAS = 20.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Uncertainty:
    """What noise does.

    Attributes
    ----------
    sigma_mm : (N,) array
        Of each point's overstock under the placement as it is.
    told, true : (K, N) arrays
        Margins as each draw tells them, and as the measured surface has them there.
    motions : (K, 6) array
        Each draw's placement against the best: shift of the centre, rotation vector (mm, rad).
    noise_mm : (K, N + T, 3) array
        Noise of the points and of the coded targets, part frame.
    """

    sigma_mm: Array
    told: Array
    true: Array
    motions: Array
    noise_mm: Array

    def expanded(self, on: NDArray[np.bool_]) -> float:
        """Return U of the smallest margin of some points: 95.45 % of the errors are smaller."""
        apart = self.told[:, on].min(axis=1) - self.true[:, on].min(axis=1)
        return float(np.quantile(np.abs(apart), COVERAGE))


def draw(
    problem: Problem, settled: Settled, survey: SurveyPoints, coded: list[SurveyPoint]
) -> Uncertainty | None:
    """Draw noise and place again; None where no point has a covariance."""
    by_name = {point.name: n for n, point in enumerate(survey.points)}
    rows = [by_name[name] for name in (*settled.points.names, *(p.name for p in coded))]
    if all(survey.points[n].covariance_mm2 is None for n in rows) and survey.full is None:
        return None
    count = len(settled.points.names)
    many = count > MANY
    random = np.random.default_rng(SEED)
    noise = _noise(survey, rows, random, DRAWS_OF_MANY if many else DRAWS)
    turned = noise @ settled.placement.rotation.T
    placement, wish = settled.placement, settled.wish
    placed = settled.points.xyz @ placement.rotation.T + placement.translation_mm
    distance, normals = problem.surfaces(settled.face, placed)

    def tangents(at: Array) -> tuple[Array, Array]:
        return distance + ((at - placed) * normals).sum(axis=1), normals

    # A rigid motion of all points moves the placement as much the other way: what is left is
    # small, whatever the survey's frame did.
    lever = _lever(placed - placement.centre_mm)
    flat = turned[:, :count].reshape(len(turned), -1)
    common = flat @ np.linalg.pinv(lever).T
    rest = (flat - common @ lever.T).reshape(len(turned), count, 3)
    radius = max(RADIUS_MM, RADIUS_SIGMAS * float(rest.std()))
    along = (rest * normals).sum(axis=2)
    told, true, motions = [], [], []
    for k in range(len(noise)):
        drawn = place_evenly(
            placed + rest[k],
            tangents,
            wish,
            thickness_mm=problem.file.target_thickness_mm,
            rounds=1,
            radius_mm=radius,
        )
        told.append(drawn.margins_mm)
        true.append(drawn.margins_mm - along[k])
        motions.append(_motion(drawn, placement) - common[k])
    return Uncertainty(
        sigma_mm=np.sqrt(_variance(survey, rows[:count], normals @ placement.rotation)),
        told=np.array(told),
        true=np.array(true),
        motions=np.array(motions),
        noise_mm=turned,
    )


def targets_covariance(
    uncertainty: Uncertainty,
    settled: Settled,
    survey: SurveyPoints,
    coded: list[SurveyPoint],
) -> Array:
    """Return the covariance (3T, 3T) of coded targets in the part frame, the fit's included.

    Where the survey tells what its points have in common, the rigid motion of all points
    together is taken out first: the fit follows it, and no place in the part sees it.
    """
    by_name = {point.name: n for n, point in enumerate(survey.points)}
    rows = [by_name[name] for name in (*settled.points.names, *(p.name for p in coded))]
    placement, count = settled.placement, len(settled.points.names)
    places = np.array([survey.points[n].xyz_mm for n in rows]) @ placement.rotation.T
    lever = _lever(places + placement.translation_mm - placement.centre_mm)
    fitted, targets = lever[: 3 * count], lever[3 * count :]
    motions = uncertainty.motions
    gain = np.zeros((6, len(targets)))
    if survey.full is None:
        own = _turned(survey, rows[count:], placement.rotation)
    else:
        together = np.linalg.pinv(fitted)
        rest = np.hstack([-targets @ together, np.eye(len(targets))])
        own = rest @ _turned(survey, rows, placement.rotation) @ rest.T
        common = uncertainty.noise_mm.reshape(len(motions), -1)[:, : 3 * count] @ together.T
        motions = motions + common
        noise = uncertainty.noise_mm.reshape(len(motions), -1)[:, 3 * count :] - common @ targets.T
        # What of the motion follows the targets' own errors; shrunk where draws are few.
        gram = noise.T @ noise
        ridge = np.trace(gram) / len(motions) + 1e-300
        gain = np.linalg.solve(gram + ridge * np.eye(len(gram)), noise.T @ motions).T
        motions = motions - noise @ gain.T
    through = np.eye(len(targets)) + targets @ gain
    covariance = through @ own @ through.T + targets @ np.cov(motions.T) @ targets.T
    return np.asarray(0.5 * (covariance + covariance.T))


def _lever(arms: Array) -> Array:
    """Return how places (N, 3) from the centre move with a shift and a turn (3N, 6)."""
    lever = np.zeros((3 * len(arms), 6))
    for i, (x, y, z) in enumerate(arms):
        lever[3 * i : 3 * i + 3, :3] = np.eye(3)
        lever[3 * i : 3 * i + 3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return lever


def _turned(survey: SurveyPoints, rows: list[int], rotation: Array) -> Array:
    """Return the survey's covariance (3K, 3K) of points, in the part frame."""
    turn = np.kron(np.eye(len(rows)), rotation)
    return np.asarray(turn @ survey.covariance(rows) @ turn.T)


def _noise(survey: SurveyPoints, rows: list[int], random: np.random.Generator, draws: int) -> Array:
    """Return noise (K, N, 3) in the survey's frame."""
    if survey.full is not None:
        root = _root(survey.covariance(rows))
        return (random.standard_normal((draws, len(root))) @ root.T).reshape(draws, -1, 3)
    own = [survey.points[n].covariance_mm2 for n in rows]
    roots = np.array([np.zeros((3, 3)) if c is None else _root(c) for c in own])
    return np.einsum("nij,knj->kni", roots, random.standard_normal((draws, len(rows), 3)))


def _variance(survey: SurveyPoints, rows: list[int], directions: Array) -> Array:
    own = [survey.points[n].covariance_mm2 for n in rows]
    blocks = np.array([np.zeros((3, 3)) if c is None else c for c in own])
    return np.asarray(np.einsum("ni,nij,nj->n", directions, blocks, directions))


def _root(covariance: Array) -> Array:
    values, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(values, 0.0)))


def _motion(drawn: Placement, best: Placement) -> Array:
    """Return how a draw's placement moves the part frame's places: shift of the centre, turn."""
    turn = Rotation.from_matrix(drawn.rotation).as_rotvec()
    centre = best.centre_mm
    return np.concatenate([drawn.rotation @ centre + drawn.translation_mm - centre, turn])
