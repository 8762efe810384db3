"""U over the CAD surface of a part, drawn from two sides for each machine axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from omm_core.budget.surface_map import SurfaceMap
from omm_report.triangle_picture import VIEWS, draw_triangles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = "viridis"


def surface_figure(found: SurfaceMap) -> Figure:
    """Draw U_total along X, Y, Z (rows) from two sides; the red cross marks the largest.

    The cross stands on the side from which that face is seen; where neither shows it, on none.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 10.5), layout="constrained")
    for index, row in enumerate(found.table()):
        values = 1e3 * found.expanded_mm[..., index]
        scale = Normalize(values.min(), max(values.max(), values.min() + 1e-3))
        colours = colormaps[COLOURS](scale(values.mean(axis=1)))[:, :3]
        areas = [
            figure.add_subplot(3, 2, 2 * index + n, projection="3d", computed_zorder=False)
            for n in (1, 2)
        ]
        for area, (elevation, azimuth, words) in zip(areas, VIEWS, strict=True):
            eye = (elevation, azimuth)
            look = draw_triangles(area, found.corners, found.normals, colours, eye, zoom=0.95)
            at = np.all(np.isclose(found.corners, row.worst_xyz_mm), axis=2).any(axis=1)
            if np.any(found.normals[at] @ look > 0.0):
                area.plot(*row.worst_xyz_mm[:, None], "x", color="red", markersize=9, zorder=1e6)
            area.set_title(f"U {row.axis}, {words}", fontsize=8)
            for name in "xyz":
                getattr(area, f"set_{name}label")(f"{name}, mm", fontsize=6)
        bar = figure.colorbar(ScalarMappable(scale, COLOURS), ax=areas, shrink=0.8)
        bar.set_label(f"U {row.axis}, µm", fontsize=8)
        bar.ax.tick_params(labelsize=7)
    return figure
