"""Placements from nothing: directions of faces are tried on each other, and what fits is kept.

Normals of the points (measured, or of planes found among the points) gather in a few directions,
as those of the CAD do. Two directions of the one laid on two of the other give a rotation; boxes
give places to begin from, and a coarse best fit on samples of the CAD tells which are worth
more. Symmetric parts have several that fit as well: all are returned.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from omm_core.overstock.assignment import Points
from omm_core.overstock.face import Face
from omm_core.overstock.triangles import triangle_areas

Array = NDArray[np.float64]
Pose = tuple[Array, Array]
SAMPLES = 4000
FEW_POINTS = 150
CLUSTER_COS = float(np.cos(np.radians(12.0)))
ANGLE_RAD = 0.15
DIRECTIONS = 10
ROUNDS = 15
KEEP = 8
APART_RAD = 0.05
# A normal that leans by 1 rad counts as far as this share of the part's size.
NORMAL_SHARE = 0.15
PLANE_MM = 4.0
FEWEST_ON_PLANE = 5
SEED = 7


@dataclass(frozen=True, kw_only=True, eq=False)
class _Samples:
    places: Array
    normals: Array
    tree: cKDTree
    scale: float


def search_placements(faces: tuple[Face, ...], points: Points) -> list[Pose]:
    """Return coarse placements part_T_survey, the best first; at most ``KEEP``."""
    samples = _sampled(faces)
    random = np.random.default_rng(SEED)
    known = np.asarray(np.isfinite(points.normals).all(axis=1))
    normals = np.where(known[:, None], points.normals, normals_from_planes(points, random))
    usable = np.isfinite(normals).all(axis=1)
    if usable.sum() < FEWEST_ON_PLANE:
        return []
    xyz, normals = points.xyz[usable], normals[usable]
    if len(xyz) > FEW_POINTS:
        chosen = np.sort(random.choice(len(xyz), FEW_POINTS, replace=False))
        xyz, normals = xyz[chosen], normals[chosen]
    found: list[tuple[float, Pose]] = []
    for rotation in _rotations(_directions(normals, np.ones(len(normals))), _cad_directions(faces)):
        for translation in _translations(rotation, xyz, samples):
            found.append(_coarse_fit((rotation, translation), xyz, normals, samples))
    return _distinct(found, samples.scale)


def normals_from_planes(points: Points, random: np.random.Generator) -> Array:
    """Return normals (N, 3) of planes among the points, away from their middle; nan elsewhere."""
    normals = np.full_like(points.xyz, np.nan)
    left = np.arange(len(points.xyz))
    middle = points.xyz.mean(axis=0)
    while len(left) >= FEWEST_ON_PLANE:
        best = np.empty(0, dtype=np.int64)
        for _ in range(400):
            a, b, c = points.xyz[random.choice(left, 3, replace=False)]
            normal = np.cross(b - a, c - a)
            length = float(np.linalg.norm(normal))
            if length < 1e-6:
                continue
            on = left[np.abs((points.xyz[left] - a) @ normal) < PLANE_MM * length]
            best = on if len(on) > len(best) else best
        if len(best) < FEWEST_ON_PLANE:
            break
        centre = points.xyz[best].mean(axis=0)
        normal = np.linalg.svd(points.xyz[best] - centre)[2][2]
        if abs((centre - middle) @ normal) > PLANE_MM:
            normals[best] = normal * np.sign((centre - middle) @ normal)
        left = np.setdiff1d(left, best)
    return normals


def _sampled(faces: tuple[Face, ...]) -> _Samples:
    random = np.random.default_rng(SEED)
    triangles = np.concatenate([face.triangles for face in faces])
    normals = np.concatenate([face.normals for face in faces])
    areas = triangle_areas(triangles)
    # Small faces tell as much of the placement as large ones: weight by the square root.
    share = np.concatenate(
        [a / max(np.sqrt(a.sum()), 1e-9) for a in (triangle_areas(f.triangles) for f in faces)]
    )
    which = random.choice(len(areas), SAMPLES, p=share / share.sum())
    u = np.sqrt(random.random((SAMPLES, 1)))
    v = random.random((SAMPLES, 1))
    a, b, c = np.moveaxis(triangles[which], 1, 0)
    places = (1.0 - u) * a + u * (1.0 - v) * b + u * v * c
    scale = float(np.linalg.norm(places.max(axis=0) - places.min(axis=0)))
    both = np.hstack([places, NORMAL_SHARE * scale * normals[which]])
    return _Samples(places=places, normals=normals[which], tree=cKDTree(both), scale=scale)


def _cad_directions(faces: tuple[Face, ...]) -> Array:
    normals = np.concatenate([face.normals for face in faces])
    weights = np.concatenate([triangle_areas(face.triangles) for face in faces])
    return _directions(normals, weights)


def _directions(normals: Array, weights: Array) -> Array:
    """Return the directions (K, 3) in which most of the weight looks, the heaviest first."""
    left = weights.copy()
    found: list[Array] = []
    near = normals @ normals.T > CLUSTER_COS if len(normals) <= 2000 else None
    while len(found) < DIRECTIONS and left.sum() > 0.02 * weights.sum():
        if near is not None:
            first = int((near @ left).argmax())
            inside = near[first]
        else:
            first = int(left.argmax())
            inside = normals @ normals[first] > CLUSTER_COS
        mean = (left[inside, None] * normals[inside]).sum(axis=0)
        found.append(mean / np.linalg.norm(mean))
        left[inside] = 0.0
    return np.array(found).reshape(-1, 3)


def _rotations(measured: Array, wanted: Array) -> list[Array]:
    """Return rotations that lay two measured directions on two of the CAD."""
    rotations: list[Array] = []
    usable = 0
    for i, j in itertools.combinations(range(len(measured)), 2):
        angle = np.arccos(np.clip(measured[i] @ measured[j], -1.0, 1.0))
        if not 0.4 < angle < np.pi - 0.4:
            continue
        usable += 1
        for k, m in itertools.permutations(range(len(wanted)), 2):
            other = np.arccos(np.clip(wanted[k] @ wanted[m], -1.0, 1.0))
            if abs(other - angle) < ANGLE_RAD:
                turn, _ = Rotation.align_vectors(wanted[[k, m]], measured[[i, j]])
                matrix = turn.as_matrix()
                if all(_turned(matrix, r) > ANGLE_RAD for r in rotations):
                    rotations.append(matrix)
        if usable == 3:
            break
    return rotations


def _turned(a: Array, b: Array) -> float:
    """Return the angle between two rotations, rad."""
    return float(np.arccos(np.clip((np.trace(a.T @ b) - 1.0) / 2.0, -1.0, 1.0)))


def _translations(rotation: Array, xyz: Array, samples: _Samples) -> list[Array]:
    """Return places to begin from: middle on middle, and the ends of each axis on each other."""
    turned = xyz @ rotation.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    cad_low, cad_high = samples.places.min(axis=0), samples.places.max(axis=0)
    middle = 0.5 * (cad_low + cad_high - low - high)
    starts = [middle]
    for axis in range(3):
        if abs((high - low)[axis] - (cad_high - cad_low)[axis]) < 0.02 * samples.scale:
            continue
        for end in (cad_low - low, cad_high - high):
            start = middle.copy()
            start[axis] = end[axis]
            starts.append(start)
    return starts


def _coarse_fit(pose: Pose, xyz: Array, normals: Array, samples: _Samples) -> tuple[float, Pose]:
    """Fit points to samples' planes; return the mean distance, far points capped, and the pose."""
    rotation, translation = pose
    cap = 0.05 * samples.scale
    for _ in range(ROUNDS):
        placed, turned = xyz @ rotation.T + translation, normals @ rotation.T
        _, which = samples.tree.query(np.hstack([placed, NORMAL_SHARE * samples.scale * turned]))
        out = samples.normals[which]
        off = ((placed - samples.places[which]) * out).sum(axis=1)
        centre = placed.mean(axis=0)
        arms = (placed - centre) / samples.scale
        rows = np.hstack([out, np.cross(arms, out)])
        weights = 1.0 / np.maximum(np.abs(off), 0.01 * samples.scale)
        left = (rows * weights[:, None]).T @ rows + 1e-9 * np.eye(6)
        step = np.linalg.solve(left, -(rows * weights[:, None]).T @ off)
        turn = Rotation.from_rotvec(step[3:] / samples.scale).as_matrix()
        rotation = turn @ rotation
        translation = turn @ (translation - centre) + centre + step[:3]
        if np.abs(step).max() < 1e-3:
            break
    placed, turned = xyz @ rotation.T + translation, normals @ rotation.T
    _, which = samples.tree.query(np.hstack([placed, NORMAL_SHARE * samples.scale * turned]))
    off = np.abs(((placed - samples.places[which]) * samples.normals[which]).sum(axis=1))
    along = np.linalg.norm(placed - samples.places[which], axis=1)
    lean = 1.0 - (turned * samples.normals[which]).sum(axis=1)
    cost = np.minimum(off + np.maximum(along - cap, 0.0), cap) + cap * np.minimum(lean, 1.0)
    return float(cost.mean()), (rotation, translation)


def _distinct(found: list[tuple[float, Pose]], scale: float) -> list[Pose]:
    kept: list[tuple[float, Pose]] = []
    for cost, pose in sorted(found, key=lambda entry: entry[0]):
        new = all(
            _turned(pose[0], other[0]) > APART_RAD
            or np.linalg.norm(pose[1] - other[1]) > 0.05 * scale
            for _, other in kept
        )
        if new:
            kept.append((cost, pose))
        if len(kept) == KEEP:
            break
    best = kept[0][0] if kept else 0.0
    return [pose for cost, pose in kept if cost < 2.0 * best + 0.005 * scale]
