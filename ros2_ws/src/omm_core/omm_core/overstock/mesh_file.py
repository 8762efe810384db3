"""Faces out of STL (binary, ascii) and PLY: triangles cut where they bend."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.overstock.face import Face
from omm_core.overstock.recognise import recognised
from omm_core.overstock.triangles import triangle_areas, triangle_normals

Array = NDArray[np.float64]
SMOOTH_RAD = 0.5
COPLANAR_RAD = 1e-4
LARGE_SHARE = 0.1
LARGE_TIMES = 10.0
LARGEST_BYTES = 500 << 20
MOST_TRIANGLES = 3_000_000


def faces_of_mesh(path: Path, unit_mm: float = 1.0) -> tuple[Face, ...]:
    """Read STL or PLY; ``unit_mm`` is what a length of 1 stands for.

    Raises
    ------
    InputError
        Where the file holds no closed, finite triangles.
    """
    mesh = _load(path)
    mesh.apply_scale(unit_mm)
    triangles = np.asarray(mesh.triangles, dtype=np.float64)
    neighbours = np.asarray(mesh.face_adjacency)
    angles = np.asarray(mesh.face_adjacency_angles)
    faces: list[Face] = []
    for part in _connected(neighbours[angles < SMOOTH_RAD], np.arange(len(triangles))):
        known = recognised(triangles[part])
        pieces = [known] if known else _pieces(triangles, part, neighbours, angles)
        faces += pieces
    return tuple(faces)


def _load(path: Path) -> Any:
    import trimesh

    if path.stat().st_size > LARGEST_BYTES:
        raise InputError(
            f"{path}: expected CAD of at most {LARGEST_BYTES >> 20} MB,"
            f" got {path.stat().st_size / 1e6:.0f} MB. Export it with a coarser tolerance."
        )
    # It logs the tracebacks of what it then tries otherwise.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        mesh: Any = trimesh.load(path, force="mesh")
        count = len(mesh.faces)
    except (Exception, MemoryError) as error:  # the library's errors have no common base
        raise InputError(f"{path} cannot be read as triangles: {str(error)[:300]}.") from None
    if count == 0:
        raise InputError(f"{path}: expected triangles, got none.")
    if count > MOST_TRIANGLES:
        raise InputError(
            f"{path}: expected at most {MOST_TRIANGLES} triangles, got {count}."
            " Export it with a coarser tolerance, or as STEP."
        )
    if not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path}: expected finite coordinates of all corners.")
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    if mesh.is_watertight and mesh.volume < 0.0:
        mesh.invert()
    return mesh


def _pieces(
    triangles: Array, part: NDArray[np.int64], neighbours: NDArray[np.int64], angles: Array
) -> list[Face]:
    """Cut flat pieces out of a smooth part, and classify what is left."""
    areas = triangle_areas(triangles)
    inside = np.isin(neighbours, part).all(axis=1)
    flat = _connected(neighbours[inside & (angles < COPLANAR_RAD)], part)
    sizes = np.array([areas[p].sum() for p in flat])
    # The strips of a bend are many and alike; what is flat in truth is larger than they are.
    chosen = (sizes > LARGE_SHARE * sizes.sum()) | (sizes > LARGE_TIMES * np.median(sizes))
    large = [p for p, is_large in zip(flat, chosen, strict=True) if is_large]
    faces = [f for f in (recognised(triangles[p]) for p in large) if f is not None]
    rest = np.setdiff1d(part, np.concatenate(large) if faces else [])
    if len(rest) == 0:
        return faces
    within = inside & np.isin(neighbours, rest).all(axis=1) & (angles < SMOOTH_RAD)
    for piece in _connected(neighbours[within], rest):
        faces.append(recognised(triangles[piece]) or _free(triangles[piece]))
    return faces


def _free(triangles: Array) -> Face:
    import trimesh

    normals = triangle_normals(triangles)
    middle = triangles.reshape(-1, 3).mean(axis=0)
    axis = normals.mean(axis=0)
    face = Face(kind="free", triangles=triangles, origin=middle, axis=axis)
    mesh = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    mesh.merge_vertices()
    own = np.repeat(normals[:, None], 3, axis=1)
    if len(mesh.faces) == len(triangles):
        own = np.asarray(mesh.vertex_normals)[mesh.faces]
    return replace(face, chord_mm=_chord(mesh), corner_normals=own)


def _chord(mesh: Any) -> float:
    """Estimate how far the triangles lie off the surface: edge times bend, by 8."""
    bends = mesh.face_adjacency_angles
    if len(bends) == 0:
        return float("nan")
    heights = 2.0 * mesh.area_faces[mesh.face_adjacency].mean(axis=1)
    ends = mesh.vertices[mesh.face_adjacency_edges]
    heights = heights / np.maximum(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 1e-12)
    return float(np.quantile(heights * bends / 8.0, 0.95))


def _connected(pairs: NDArray[np.int64], nodes: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    import trimesh

    parts = trimesh.graph.connected_components(pairs, nodes=nodes)
    return sorted((np.sort(p) for p in parts), key=lambda p: int(p[0]))
