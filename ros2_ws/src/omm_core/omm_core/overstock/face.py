"""Faces of the finished part: planes, cylinders, cones, spheres, tori, and triangles.

All answer the same question: how far outside the material is a point, and which way is out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from omm_core.overstock.triangles import TriangleIndex, barycentric, triangle_normals

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Face:
    """One face, in the part frame.

    Attributes
    ----------
    kind : str
        plane, cylinder, cone, sphere, torus; or free, known by its triangles only.
    triangles : (M, 3, 3) array
        Corners, mm; turned so that their normals point out of the material.
    origin : (3,) array
        A point on the plane or the axis; the cone's apex; the centre of sphere or torus.
    axis : (3,) unit array
        Outward normal of the plane; axis of the others (the cone's from its apex to the face).
    radius_mm : float
        Of cylinder or sphere; of the torus' tube.
    ring_radius_mm : float
        Of the torus.
    half_angle_rad : float
        Of the cone.
    sign : float
        1 where the material is inside, -1 for a bore.
    chord_mm : float
        How far a free face may lie off what is computed; nan where not known.
    corner_normals : (M, 3, 3) array or None
        The surface's own normals at the corners of a free face, which tell how it bulges.
    label, colour : str
        What the file calls the face; its colour as #rrggbb. Empty where the file does not tell.
    """

    kind: str
    triangles: Array
    origin: Array
    axis: Array
    radius_mm: float = 0.0
    ring_radius_mm: float = 0.0
    half_angle_rad: float = 0.0
    sign: float = 1.0
    chord_mm: float = 0.0
    corner_normals: Array | None = None
    label: str = ""
    colour: str = ""

    @cached_property
    def index(self) -> TriangleIndex:
        """Return the triangles as something to search in."""
        return TriangleIndex(self.triangles)

    @cached_property
    def normals(self) -> Array:
        """Return the triangles' outward unit normals (M, 3)."""
        return triangle_normals(self.triangles)

    @cached_property
    def middle(self) -> Array:
        """Return the middle of the face's box."""
        return 0.5 * (self.index.low + self.index.high)

    @property
    def name(self) -> str:
        """Return label, kind, direction and place in words."""
        return f"{self.label}: {self._words()}" if self.label else self._words()

    def _words(self) -> str:
        place = " ".join(f"{v + 0.0:.1f}" for v in np.round(self.middle, 1))
        if self.kind == "plane":
            direction = " ".join(f"{v + 0.0:.3g}" for v in np.round(self.axis, 3))
            return f"plane ({direction}) at {np.round(self.axis @ self.origin, 3) + 0.0:.3f}"
        if self.kind == "free":
            return f"free-form around ({place})"
        hollow = self.sign < 0.0
        if self.kind == "cone":
            angle = np.degrees(self.half_angle_rad)
            return f"{'hollow ' * hollow}cone {angle:.2f}° around ({place})"
        if self.kind == "torus":
            size = f"radii {self.ring_radius_mm:.3f} {self.radius_mm:.3f}"
            return f"{'hollow ' * hollow}torus {size} around ({place})"
        what = {"cylinder": ("cylinder", "bore"), "sphere": ("sphere", "hollow sphere")}
        return f"{what[self.kind][hollow]} radius {self.radius_mm:.3f} around ({place})"

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Return how far points (N, 3) are outside the face, and its normals there (N, 3).

        The surface counts as going on beyond the face's edges; triangles do not.
        """
        if self.kind == "plane":
            return (points - self.origin) @ self.axis, np.tile(self.axis, (len(points), 1))
        if self.kind == "free":
            return self._off_triangles(points)
        arms = points - self.origin
        if self.kind == "sphere":
            length, out = _split(arms)
            return self.sign * (length - self.radius_mm), self.sign * out
        height = arms @ self.axis
        radius, out = _split(arms - np.outer(height, self.axis))
        if self.kind == "cylinder":
            return self.sign * (radius - self.radius_mm), self.sign * out
        if self.kind == "cone":
            cos, sin = np.cos(self.half_angle_rad), np.sin(self.half_angle_rad)
            return self.sign * (radius * cos - height * sin), self.sign * (
                cos * out - sin * self.axis
            )
        tube = (radius - self.ring_radius_mm)[:, None] * out + np.outer(height, self.axis)
        length, out = _split(tube)
        return self.sign * (length - self.radius_mm), self.sign * out

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Return the distance (N,) from the face within its edges, and its normals (N, 3)."""
        places, which = self.index.nearest(points)
        normals = self.normals[which]
        if self.corner_normals is not None:
            normals, _ = self._bulge(places, which, self.corner_normals)
        return np.linalg.norm(points - places, axis=1), normals

    def _bulge(
        self, places: Array, which: NDArray[np.int64], corner_normals: Array
    ) -> tuple[Array, Array]:
        """Return normals (N, 3) and how far the surface lies outside the triangles (N,).

        Half of what the tangent planes at the corners tell, weighted as the place lies between
        them: exact where the surface is a quadric.
        """
        corners, own = self.triangles[which], corner_normals[which]
        weights = barycentric(corners, places)
        above = ((corners - places[:, None]) * own).sum(axis=2)
        _, normals = _split((weights[:, :, None] * own).sum(axis=1))
        return normals, 0.5 * (weights * above).sum(axis=1)

    def _off_triangles(self, points: Array) -> tuple[Array, Array]:
        places, which = self.index.nearest(points)
        arms = points - places
        normals, bulge = self.normals[which], np.zeros(len(points))
        if self.corner_normals is not None:
            normals, bulge = self._bulge(places, which, self.corner_normals)
        side = np.where((arms * normals).sum(axis=1) < 0.0, -1.0, 1.0)
        length = np.linalg.norm(arms, axis=1)
        # Across an edge between two triangles the way out is the way to the point.
        far = (length > 1e-3) & (self.corner_normals is None)
        normals = np.where(
            far[:, None], side[:, None] * arms / np.maximum(length, 1e-12)[:, None], normals
        )
        return side * length - bulge, normals


def _split(arms: Array) -> tuple[Array, Array]:
    """Return lengths and unit vectors."""
    length = np.linalg.norm(arms, axis=1)
    return length, arms / np.maximum(length, 1e-12)[:, None]
