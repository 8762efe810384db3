"""Triangles of a part in an area of matplotlib, as the eye sees them from one side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
VIEWS = ((30.0, -60.0, "from the front, above"), (-30.0, 120.0, "from the back, below"))
"""Elevation, azimuth (degrees), words: between them they show every side of a block."""


def draw_triangles(  # type: ignore[no-untyped-def]
    area,
    corners: Array,
    normals: Array,
    colours: Array,
    eye_deg: tuple[float, float],
    zoom: float = 1.15,
) -> Array:
    """Draw the triangles that face the eye; return the direction to the eye (3,).

    Parameters
    ----------
    corners, normals, colours : (M, 3, 3), (M, 3), (M, 3) arrays
        mm; outward; red, green, blue from 0 to 1.
    eye_deg : elevation and azimuth
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    up, round_ = np.radians(eye_deg)
    look = np.array([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)])
    seen = normals @ look > 0.0
    light = (0.55 + 0.45 * np.abs(normals[seen] @ look))[:, None]
    shaded = np.clip(colours[seen] * light, 0.0, 1.0)
    area.add_collection3d(
        Poly3DCollection(corners[seen], facecolors=shaded, edgecolors=shaded, linewidths=0.2)
    )
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    area.set_xlim(middle[0] - half[0], middle[0] + half[0])
    area.set_ylim(middle[1] - half[1], middle[1] + half[1])
    area.set_zlim(middle[2] - half[2], middle[2] + half[2])
    area.set_box_aspect(np.maximum(half, 0.05 * half.max()), zoom=zoom)
    area.view_init(*eye_deg)
    area.tick_params(labelsize=6)
    area.set_proj_type("ortho")
    return look
