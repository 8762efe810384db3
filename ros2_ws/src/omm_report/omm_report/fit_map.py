"""Overstock spread over the part, for pictures: triangles with a value at each corner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.overstock.face import Face
from omm_core.overstock.fit import Fit

Array = NDArray[np.float64]
PIECES = 30.0
MOST = 12_000
NEIGHBOURS = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class PartMap:
    """What is drawn, part frame.

    Attributes
    ----------
    corners : (M, 3, 3) array
        Triangles, mm.
    normals : (M, 3) array
        Outward.
    face : (M,) array of int
        Face of each triangle, from 0.
    values : (M, 3) array
        Overstock at the corners, mm; nan on faces without points.
    points, point_values : (N, 3), (N,) arrays
        Measured points and their overstock, mm.
    point_names : tuple of str
    """

    corners: Array
    normals: Array
    face: NDArray[np.int64]
    values: Array
    points: Array
    point_values: Array
    point_names: tuple[str, ...]


def map_of_fit(fit: Fit) -> PartMap:
    """Return the part coloured by a fit: between points of a face by inverse square distance."""
    settled = fit.settled
    places, _ = settled.points.placed(settled.placement.pose)
    groups = fit.problem.groups.of_face
    corners, normals, face = _cut(fit.problem.faces)
    values = np.full((len(corners), 3), np.nan)
    for group in np.unique(settled.wish.groups):
        on = settled.wish.groups == group
        drawn = groups[face] == group
        flat = corners[drawn].reshape(-1, 3)
        told = _between(flat, places[on], settled.placement.overstock_mm[on])
        values[drawn] = told.reshape(-1, 3)
    return PartMap(
        corners=corners,
        normals=normals,
        face=face,
        values=values,
        points=places,
        point_values=settled.placement.overstock_mm,
        point_names=settled.points.names,
    )


def map_of_faces(faces: tuple[Face, ...]) -> PartMap:
    """Return the part without values, to draw its faces with numbers."""
    corners, normals, face = _cut(faces)
    return PartMap(
        corners=corners,
        normals=normals,
        face=face,
        values=np.full((len(corners), 3), np.nan),
        points=np.empty((0, 3)),
        point_values=np.empty(0),
        point_names=(),
    )


def _cut(faces: tuple[Face, ...]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return triangles small enough to carry a colour, outward normals, faces."""
    corners = np.concatenate([face.triangles for face in faces])
    number = np.repeat(np.arange(len(faces)), [len(face.triangles) for face in faces])
    size = float(np.linalg.norm(corners.max(axis=(0, 1)) - corners.min(axis=(0, 1)))) / PIECES
    done, numbers = [], []
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        large = (edges.max(axis=1) > size) & (len(corners) < MOST)
        done.append(corners[~large])
        numbers.append(number[~large])
        corners, edges, number = corners[large], edges[large], np.repeat(number[large], 2)
        rows, first = np.arange(len(corners)), edges.argmax(axis=1)
        a, b, c = (corners[rows, (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        corners = np.stack(halves, axis=1).reshape(-1, 3, 3)
    triangles, face = np.concatenate(done), np.concatenate(numbers)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return triangles, cross / np.maximum(length, 1e-300), face


def _between(places: Array, points: Array, values: Array) -> Array:
    from scipy.spatial import cKDTree

    count = min(NEIGHBOURS, len(points))
    distance, which = cKDTree(points).query(places, k=count)
    distance, which = distance.reshape(-1, count), which.reshape(-1, count)
    weights = 1.0 / np.maximum(distance, 1e-3) ** 2
    return np.asarray((weights * values[which]).sum(axis=1) / weights.sum(axis=1))
