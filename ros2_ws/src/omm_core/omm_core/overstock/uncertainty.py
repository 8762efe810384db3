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
from omm_core.overstock.placement import Placement, place_evenly
from omm_core.overstock.problem import Problem, Settled

Array = NDArray[np.float64]
DRAWS = 200
DRAWS_OF_MANY = 60
MANY = 1000
SEED = 1
COVERAGE = 0.9545
RADIUS_MM = 1.0


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
    targets_mm : (K, T, 3) array
        Noise of the coded targets, part frame.
    """

    sigma_mm: Array
    told: Array
    true: Array
    motions: Array
    targets_mm: Array

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

    along = (turned[:, :count] * normals).sum(axis=2)
    told, true, motions = [], [], []
    for k in range(len(noise)):
        drawn = place_evenly(
            placed + turned[k, :count],
            tangents,
            wish,
            thickness_mm=problem.file.target_thickness_mm,
            rounds=1,
            radius_mm=RADIUS_MM,
        )
        told.append(drawn.margins_mm)
        true.append(drawn.margins_mm - along[k])
        motions.append(_motion(drawn, placement))
    return Uncertainty(
        sigma_mm=np.sqrt(_variance(survey, rows[:count], normals @ placement.rotation)),
        told=np.array(told),
        true=np.array(true),
        motions=np.array(motions),
        targets_mm=turned[:, count:],
    )


def targets_covariance(
    uncertainty: Uncertainty, placement: Placement, places: Array, own: Array, *, correlated: bool
) -> Array:
    """Return the covariance (3T, 3T) of coded targets in the part frame, the fit's included.

    Parameters
    ----------
    places : (T, 3) array
        The targets in the part frame, mm.
    own : (3T, 3T) array
        The survey's covariance of them, turned into the part frame.
    correlated : bool
        Whether they have errors in common with the points that were fitted.
    """
    arms = places - placement.centre_mm
    lever = np.zeros((3 * len(places), 6))
    for i, arm in enumerate(arms):
        lever[3 * i : 3 * i + 3, :3] = np.eye(3)
        lever[3 * i : 3 * i + 3, 3:] = -_cross(arm)
    motions = uncertainty.motions - uncertainty.motions.mean(axis=0)
    gain = np.zeros((6, len(own)))
    if correlated:
        # What of the motion follows the targets' own errors; shrunk where draws are few.
        noise = uncertainty.targets_mm.reshape(len(motions), -1)
        gram = noise.T @ noise
        ridge = np.trace(gram) / len(gram) * len(gram) / len(motions) + 1e-300
        gain = np.linalg.solve(gram + ridge * np.eye(len(gram)), noise.T @ motions).T
        motions = motions - noise @ gain.T
    through = np.eye(len(own)) + lever @ gain
    covariance = through @ own @ through.T + lever @ np.cov(motions.T) @ lever.T
    return np.asarray(0.5 * (covariance + covariance.T))


def turned_covariance(survey: SurveyPoints, points: list[SurveyPoint], rotation: Array) -> Array:
    """Return the survey's covariance (3T, 3T) of points, in the part frame."""
    by_name = {point.name: n for n, point in enumerate(survey.points)}
    rows = [by_name[point.name] for point in points]
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


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
