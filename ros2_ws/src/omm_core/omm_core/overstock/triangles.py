"""The nearest place on a heap of triangles, quick for many points and many triangles."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FEW = 32
CANDIDATES = 12
PIECES = 40.0
BLOCK = 400_000


def triangle_normals(triangles: Array) -> Array:
    """Return unit normals (M, 3); zero where a triangle has no area."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1), 1e-300)[:, None])


def triangle_areas(triangles: Array) -> Array:
    """Return areas (M,), mm²."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(0.5 * np.linalg.norm(cross, axis=1))


def barycentric(triangles: Array, places: Array) -> Array:
    """Return the weights (N, 3) of the corners of triangles (N, 3, 3) at places (N, 3) in them."""
    a = triangles[:, 1] - triangles[:, 0]
    b = triangles[:, 2] - triangles[:, 0]
    arm = places - triangles[:, 0]
    aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
    ap, bp = (a * arm).sum(axis=1), (b * arm).sum(axis=1)
    whole = np.maximum(aa * bb - ab * ab, 1e-300)
    second, third = (bb * ap - ab * bp) / whole, (aa * bp - ab * ap) / whole
    weights = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, 1.0)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


class TriangleIndex:
    """Triangles (M, 3, 3), mm, that tell which of them is nearest to a point.

    Where there are many, only those whose samples are nearest are looked at exactly: samples lie
    no further apart than a 40th of the whole.
    """

    def __init__(self, triangles: Array) -> None:
        self.triangles = triangles
        corners = triangles.reshape(-1, 3)
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)

    def box_distance(self, points: Array) -> Array:
        """Return a lower bound of the distance of points (N, 3)."""
        outside = np.maximum(np.maximum(self.low - points, points - self.high), 0.0)
        return np.asarray(np.linalg.norm(outside, axis=1))

    def nearest(self, points: Array) -> tuple[Array, NDArray[np.int64]]:
        """Return the nearest places (N, 3) and the triangles they lie on (N,)."""
        count = len(self.triangles)
        if count <= FEW:
            candidates = np.broadcast_to(np.arange(count), (len(points), count))
        else:
            tree, owner = self._samples
            _, found = tree.query(points, k=min(CANDIDATES, len(owner)))
            candidates = owner[np.asarray(found).reshape(len(points), -1)]
        places, which = np.empty_like(points), np.empty(len(points), dtype=np.int64)
        chunk = max(1, BLOCK // candidates.shape[1])
        for start in range(0, len(points), chunk):
            part = slice(start, start + chunk)
            places[part], which[part] = self._exactly(points[part], candidates[part])
        return places, which

    def _exactly(self, points: Array, candidates: NDArray[np.int64]) -> tuple[Array, Array]:
        from trimesh.triangles import closest_point

        shape = candidates.shape
        on = closest_point(
            self.triangles[candidates.ravel()], np.repeat(points, shape[1], axis=0)
        ).reshape(*shape, 3)
        best = ((on - points[:, None]) ** 2).sum(axis=2).argmin(axis=1)
        rows = np.arange(shape[0])
        return on[rows, best], candidates[rows, best]

    @cached_property
    def _samples(self) -> tuple[Any, NDArray[np.int64]]:
        from scipy.spatial import cKDTree

        longest = float(np.linalg.norm(self.high - self.low)) / PIECES
        corners, owner = self.triangles, np.arange(len(self.triangles))
        samples, owners = [corners.mean(axis=1)], [owner]
        while len(corners):
            samples += [corners[:, 0], corners[:, 1], corners[:, 2]]
            owners += [owner] * 3
            edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
            large = edges.max(axis=1) > longest
            corners, owner = _halved(corners[large], edges[large]), np.repeat(owner[large], 2)
            samples.append(corners.mean(axis=1))
            owners.append(owner)
        return cKDTree(np.vstack(samples)), np.concatenate(owners)


def _halved(corners: Array, edges: Array) -> Array:
    """Return both halves of triangles, cut across their longest edge (K, 3, 3) -> (2K, 3, 3)."""
    rows = np.arange(len(corners))
    first = edges.argmax(axis=1)
    a, b = corners[rows, first], corners[rows, (first + 1) % 3]
    c, middle = corners[rows, (first + 2) % 3], None
    middle = 0.5 * (a + b)
    halves = np.stack([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)], axis=1)
    return halves.reshape(-1, 3, 3)
