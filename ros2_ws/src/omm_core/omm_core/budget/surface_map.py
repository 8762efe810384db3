"""U over the surface of a part, as its CAD tells it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceRow:
    """U along one machine axis over the surface, mm, and where it is largest (part frame, mm)."""

    axis: str
    smallest_mm: float
    mean_mm: float
    largest_mm: float
    worst_xyz_mm: Array
    worst_face: str


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceMap:
    """U_total at the corners of triangles that cover the part's surface.

    Attributes
    ----------
    corners : (M, 3, 3) array
        Triangles, part frame, mm.
    normals : (M, 3) array
        Outward.
    area_mm2 : (M,) array
    face : (M,) array of int
        Which of ``face_names`` a triangle belongs to.
    expanded_mm : (M, 3, 3) array
        By triangle and corner, along machine X Y Z.
    """

    corners: Array
    normals: Array
    area_mm2: Array
    face: NDArray[np.int64]
    face_names: tuple[str, ...]
    expanded_mm: Array

    def table(self) -> list[SurfaceRow]:
        """Return a row for each machine axis; means are by area."""
        means = np.average(self.expanded_mm.mean(axis=1), axis=0, weights=self.area_mm2)
        rows = []
        for axis, name in enumerate("XYZ"):
            values = self.expanded_mm[..., axis]
            triangle, corner = np.unravel_index(int(np.argmax(values)), values.shape)
            rows.append(
                SurfaceRow(
                    axis=name,
                    smallest_mm=float(values.min()),
                    mean_mm=float(means[axis]),
                    largest_mm=float(values[triangle, corner]),
                    worst_xyz_mm=self.corners[triangle, corner],
                    worst_face=self.face_names[self.face[triangle]],
                )
            )
        return rows

    def to_json_dict(self) -> dict[str, Any]:
        """Return the table."""
        return {
            "triangles": len(self.corners),
            "axes": [
                {
                    "axis": row.axis,
                    "smallest_mm": row.smallest_mm,
                    "mean_mm": row.mean_mm,
                    "largest_mm": row.largest_mm,
                    "worst_xyz_mm": row.worst_xyz_mm.tolist(),
                    "worst_face": row.worst_face,
                }
                for row in self.table()
            ],
        }
