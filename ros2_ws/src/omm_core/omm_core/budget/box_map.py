"""U over the whole box of a part, not in one point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxMap:
    """U_total on a grid over the part's box.

    Attributes
    ----------
    axes_mm : tuple of three arrays
        x, y, z of the grid, part frame; one value where the box is flat.
    expanded_mm : (nx, ny, nz, 3) array
        Along machine X Y Z.
    """

    axes_mm: tuple[Array, Array, Array]
    expanded_mm: Array

    def worst_of_axis(self, axis: int) -> tuple[Array, float]:
        """Return where in the box U along a machine axis is largest (part frame), and how large."""
        values = self.expanded_mm[..., axis]
        at = np.unravel_index(int(np.argmax(values)), values.shape)
        place = np.array([line[i] for line, i in zip(self.axes_mm, at)])
        return place, float(values[at])

    def table(self) -> list[tuple[str, float, float, float, Array]]:
        """Return for each machine axis: smallest, mean, largest U, and where it is largest."""
        rows = []
        for axis, name in enumerate("XYZ"):
            values = self.expanded_mm[..., axis]
            place, largest = self.worst_of_axis(axis)
            rows.append((name, float(values.min()), float(values.mean()), largest, place))
        return rows

    def to_json_dict(self) -> dict[str, Any]:
        """Return the grid, U on it, and the table."""
        x, y, z = self.axes_mm
        return {
            "x_mm": x.tolist(),
            "y_mm": y.tolist(),
            "z_mm": z.tolist(),
            "U_total_mm": self.expanded_mm.tolist(),
            "axes": [
                {
                    "axis": name,
                    "smallest_mm": low,
                    "mean_mm": mean,
                    "largest_mm": high,
                    "worst_xyz_mm": place.tolist(),
                }
                for name, low, mean, high, place in self.table()
            ],
        }


def grid_of(box: Array, steps: int) -> tuple[tuple[Array, Array, Array], Array]:
    """Return the lines of a grid over a box (2, 3), and its points (nx, ny, nz, 3)."""
    x, y, z = (
        np.linspace(low, high, steps) if high > low else np.array([low])
        for low, high in zip(box[0], box[1])
    )
    return (x, y, z), np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
