"""Overstock spread over the part, for pictures: triangles with a value at each corner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.overstock.face import Face
from omm_core.overstock.fit import Fit
from omm_core.overstock.pieces import cut_small
from omm_core.overstock.triangles import triangle_normals

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
    triangles, face = cut_small(faces, pieces=PIECES, most=MOST)
    return triangles, triangle_normals(triangles), face


def _between(places: Array, points: Array, values: Array) -> Array:
    from scipy.spatial import cKDTree

    count = min(NEIGHBOURS, len(points))
    distance, which = cKDTree(points).query(places, k=count)
    distance, which = distance.reshape(-1, count), which.reshape(-1, count)
    weights = 1.0 / np.maximum(distance, 1e-3) ** 2
    return np.asarray((weights * values[which]).sum(axis=1) / weights.sum(axis=1))
