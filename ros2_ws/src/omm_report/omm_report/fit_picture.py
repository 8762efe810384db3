"""Pictures of a fit: the part from two sides, coloured by overstock or with its faces' numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omm_report.fit_map import PartMap
from omm_report.triangle_picture import VIEWS, draw_triangles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
COLOURS = "RdYlGn"
GREY = (0.75, 0.75, 0.78)
# Places of a face that are tried for its number.
FEW = 60


def colour_range(drawn: PartMap) -> tuple[float, float]:
    """Return what the ends of the scale stand for, mm."""
    if len(drawn.point_values) == 0:
        return 0.0, 1.0
    low, high = float(drawn.point_values.min()), float(drawn.point_values.max())
    return min(low, 0.0), max(high, low + 0.1)


def overstock_figure(drawn: PartMap) -> Figure:
    """Return the part from two sides, coloured by overstock, with the points."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    low, high = colour_range(drawn)
    scale = Normalize(low, high)
    means = drawn.values.mean(axis=1)
    colours = colormaps[COLOURS](scale(np.nan_to_num(means)))[:, :3]
    colours[np.isnan(means)] = GREY
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = [
        figure.add_subplot(1, 2, n + 1, projection="3d", computed_zorder=False) for n in range(2)
    ]
    for area, (elevation, azimuth, words) in zip(axes, VIEWS, strict=True):
        look = draw_triangles(area, drawn.corners, drawn.normals, colours, (elevation, azimuth))
        seen = _towards(drawn, look)
        area.scatter(*drawn.points[seen].T, s=4, c="black", depthshade=False, zorder=1e6)
        area.set_title(words, fontsize=8)
    bar = figure.colorbar(ScalarMappable(scale, COLOURS), ax=axes, shrink=0.7)
    bar.set_label("overstock, mm (grey: no points)", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    return figure


def faces_figure(drawn: PartMap) -> Figure:
    """Return the part from two sides, each face with its number (from 1)."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    colours = colormaps["tab20"](drawn.face % 20)[:, :3] * 0.6 + 0.4
    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    for n, (elevation, azimuth, words) in enumerate(VIEWS):
        area = figure.add_subplot(1, 2, n + 1, projection="3d", computed_zorder=False)
        look = draw_triangles(area, drawn.corners, drawn.normals, colours, (elevation, azimuth))
        for number in np.unique(drawn.face):
            seen = (drawn.face == number) & (drawn.normals @ look > 0.05)
            middle = drawn.corners[seen].mean(axis=1)
            middle = middle[:: max(1, len(middle) // FEW)]
            middle = middle[np.array([not _hidden(drawn, p, look) for p in middle], dtype=bool)]
            if len(middle):
                place = middle[np.linalg.norm(middle - middle.mean(axis=0), axis=1).argmin()]
                area.text(*(place + 0.01 * look), str(number + 1), fontsize=9, zorder=1e6)
        area.set_title(words, fontsize=8)
    return figure


def _hidden(drawn: PartMap, place: Array, look: Array) -> bool:
    """Return whether a triangle lies between a place on the part and the eye."""
    a, b, c = np.moveaxis(drawn.corners, 1, 0)
    lean = drawn.normals @ look
    facing = lean > 1e-6
    a, b, c, lean, normals = a[facing], b[facing], c[facing], lean[facing], drawn.normals[facing]
    ahead = ((a - place) * normals).sum(axis=1) / lean
    hit = place + ahead[:, None] * look
    inside = np.ones(len(a), dtype=bool)
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(end - start, hit - start) * normals).sum(axis=1) >= 0.0
    return bool((inside & (ahead > 1e-3 * np.ptp(drawn.corners))).any())


def _towards(drawn: PartMap, look: Array) -> NDArray[np.bool_]:
    """Return which points lie on triangles that face the eye."""
    if len(drawn.points) == 0:
        return np.zeros(0, dtype=bool)
    from scipy.spatial import cKDTree

    _, which = cKDTree(drawn.corners.mean(axis=1)).query(drawn.points)
    return np.asarray(drawn.normals[which] @ look > 0.0)
