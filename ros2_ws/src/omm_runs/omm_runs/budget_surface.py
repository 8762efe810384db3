"""U over the part's CAD surface: the budget evaluated at the corners of small triangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.surface_map import SurfaceMap
from omm_core.overstock.cad import load_faces
from omm_core.overstock.pieces import cut_small
from omm_core.overstock.triangles import triangle_areas, triangle_normals
from omm_runs.budgeting import BudgetSources, expanded_at

Array = NDArray[np.float64]
PIECES = 40.0
MOST = 12_000
_BESIDE = 0.05  # of the diagonal


def surface_map_of(
    sources: BudgetSources, root: Path | None = None
) -> tuple[SurfaceMap | None, tuple[str, ...]]:
    """Return U_total over the CAD that budget.yaml names, and what is to be said of it.

    None where it names none. ``root`` holds the lock file of the optional STEP reader.

    Raises
    ------
    InputError
        Where the CAD cannot be read.
    """
    if sources.file.cad is None:
        return None, ()
    faces = load_faces(sources.file.cad, root, sources.file.cad_unit_mm)
    corners, face = cut_small(faces, pieces=PIECES, most=MOST)
    # Neighbours share corners: each place once.
    places, which = np.unique(
        np.round(corners.reshape(-1, 3), 6), axis=0, return_inverse=True
    )  # nm, so that the same corner of two faces is the same
    expanded = expanded_at(sources, places)[which.reshape(-1)].reshape(corners.shape)
    found = SurfaceMap(
        corners=corners,
        normals=triangle_normals(corners),
        area_mm2=triangle_areas(corners),
        face=face,
        face_names=tuple(one.name for one in faces),
        expanded_mm=expanded,
    )
    return found, _findings(sources, corners)


def _findings(sources: BudgetSources, corners: Array) -> tuple[str, ...]:
    """Say where the targets do not lie about the CAD: another unit, or another frame."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    targets = np.array([target.xyz_mm for target in sources.part.targets])
    slack = _BESIDE * float(np.linalg.norm(high - low))
    beside = np.any((targets < low - slack) | (targets > high + slack), axis=1)
    size, spread = (float(np.linalg.norm(v)) for v in (high - low, np.ptp(targets, axis=0)))
    if not beside.any() and size < 10.0 * max(spread, 1e-9):
        return ()
    return (
        f"cad: {int(beside.sum())} of {len(targets)} targets lie beside the CAD, which is"
        f" {size:.0f} mm from corner to corner, the targets {spread:.0f} mm: see whether its"
        " unit (cad_unit) is right, and whether it is in the part frame",
    )
