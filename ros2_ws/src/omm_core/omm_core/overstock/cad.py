"""Faces of the finished part out of STEP, STL or PLY."""

from __future__ import annotations

import json
import logging
import struct
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError

Array = NDArray[np.float64]
SMOOTH_RAD = 0.5
CHORD_MM = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class Face:
    """One face: a plane, cylinder or sphere as what it is, anything else by its triangles.

    Attributes
    ----------
    kind : str
        plane, cylinder, sphere or free.
    triangles : (M, 3, 3) array
        Corners, mm, part frame; turned so that their normals point out of the material.
    origin, axis : (3,) arrays
        A point on the plane and its outward normal; or of the axis; centre of the sphere.
    radius_mm : float
        Of cylinder or sphere.
    sign : float
        1 where the material is inside, -1 for a bore.
    """

    kind: str
    triangles: Array
    origin: Array
    axis: Array
    radius_mm: float = 0.0
    sign: float = 1.0

    @property
    def name(self) -> str:
        """Return kind, direction and place in words."""
        if self.kind == "plane":
            direction = " ".join(f"{v + 0.0:.3g}" for v in np.round(self.axis, 3))
            return f"plane ({direction}) at {self.axis @ self.origin + 0.0:.3f}"
        middle = self.triangles.reshape(-1, 3).mean(axis=0)
        place = " ".join(f"{v:.1f}" for v in middle)
        if self.kind == "free":
            return f"free-form around ({place})"
        what = "bore" if self.sign < 0.0 else self.kind
        return f"{what} radius {self.radius_mm:.3f} around ({place})"

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Return how far points (N, 3) are outside the face, and its normals there (N, 3)."""
        if self.kind == "plane":
            return (points - self.origin) @ self.axis, np.tile(self.axis, (len(points), 1))
        if self.kind == "free":
            return self._free(points)
        arms = points - self.origin
        if self.kind == "cylinder":
            arms = arms - np.outer(arms @ self.axis, self.axis)
        lengths = np.linalg.norm(arms, axis=1)
        normals = arms / np.maximum(lengths, 1e-12)[:, None]
        return self.sign * (lengths - self.radius_mm), self.sign * normals

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Return the nearest places (N, 3) on the face's triangles and their normals."""
        from trimesh.triangles import closest_point

        count = len(self.triangles)
        places, normals = np.empty_like(points), np.empty_like(points)
        own = triangle_normals(self.triangles)
        chunk = max(1, 20000 // count)
        for start in range(0, len(points), chunk):
            block = points[start : start + chunk]
            all_triangles = np.tile(self.triangles, (len(block), 1, 1))
            candidates = closest_point(all_triangles, np.repeat(block, count, axis=0))
            candidates = candidates.reshape(len(block), count, 3)
            best = ((candidates - block[:, None]) ** 2).sum(axis=2).argmin(axis=1)
            places[start : start + chunk] = candidates[np.arange(len(block)), best]
            normals[start : start + chunk] = own[best]
        return places, normals

    def _free(self, points: Array) -> tuple[Array, Array]:
        places, normals = self.nearest(points)
        return ((points - places) * normals).sum(axis=1), normals


def triangle_normals(triangles: Array) -> Array:
    """Return unit normals (M, 3)."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1), 1e-300)[:, None])


def load_faces(path: Path, root: Path | None = None) -> tuple[Face, ...]:
    """Read the faces of a STEP, STL or PLY file; ``root`` holds requirements/step.lock.

    Raises
    ------
    InputError
        Where the file cannot be read or the optional STEP reader cannot be installed.
    """
    if not path.is_file():
        raise InputError(f"Expected the CAD at {path}, but there is no such file.")
    if path.suffix.lower() in (".step", ".stp"):
        return _from_step(path, root)
    if path.suffix.lower() in (".stl", ".ply"):
        return _from_mesh(path)
    raise InputError(f"{path}: expected STEP, STL or PLY, got '{path.suffix}'.")


def _from_mesh(path: Path) -> tuple[Face, ...]:
    import trimesh

    # It logs the tracebacks of what it then tries otherwise.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        mesh: Any = trimesh.load(path, force="mesh")
    except (Exception, MemoryError) as error:  # the library's errors have no common base
        raise InputError(f"{path} cannot be read as triangles: {str(error)[:300]}.") from None
    if len(mesh.faces) == 0:
        raise InputError(f"{path}: expected triangles, got none.")
    if not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path}: expected finite coordinates of all corners.")
    mesh.merge_vertices()
    smooth = mesh.face_adjacency[mesh.face_adjacency_angles < SMOOTH_RAD]
    parts = trimesh.graph.connected_components(smooth, nodes=np.arange(len(mesh.faces)))
    triangles = np.asarray(mesh.triangles, dtype=np.float64)
    return tuple(_face_of(triangles[np.sort(part)], None) for part in parts)


def _from_step(path: Path, root: Path | None) -> tuple[Face, ...]:
    cascadio = _step_reader(root)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "part.glb"
        status = cascadio.step_to_glb(
            str(path), str(out), tol_linear=CHORD_MM, tol_angular=0.1, include_brep=True
        )
        if status != 0 or not out.is_file():
            raise InputError(f"{path} cannot be read as STEP (the reader says {status}).")
        data = out.read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    head, body = json.loads(data[20 : 20 + size]), data[28 + size :]
    if any({"matrix", "rotation", "translation"} & set(node) for node in head.get("nodes", [])):
        raise InputError(f"{path}: expected one part in its own frame, got an assembly.")
    faces: list[Face] = []
    for mesh in head["meshes"]:
        for primitive in mesh["primitives"]:
            faces += _of_primitive(head, body, primitive)
    return tuple(faces)


def _of_primitive(head: dict[str, Any], body: bytes, primitive: dict[str, Any]) -> list[Face]:
    places = _accessor(head, body, primitive["attributes"]["POSITION"]).reshape(-1, 3) * 1000.0
    corners = _accessor(head, body, primitive["indices"]).reshape(-1, 3).astype(int)
    triangles = places.astype(np.float64)[corners]
    brep = primitive["extensions"]["TM_brep_faces"]
    numbers = _accessor(head, body, brep["faceIndices"]).astype(int)
    known = {face["face_index"]: face for face in brep["faces"]}
    return [_face_of(triangles[numbers == n], known.get(int(n))) for n in np.unique(numbers)]


def _accessor(head: dict[str, Any], body: bytes, number: int) -> NDArray[Any]:
    accessor = head["accessors"][number]
    view = head["bufferViews"][accessor["bufferView"]]
    kind = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[accessor["componentType"]]
    count = accessor["count"] * {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return np.frombuffer(body, dtype=kind, count=count, offset=start)


def _face_of(triangles: Array, brep: dict[str, Any] | None) -> Face:
    normals = triangle_normals(triangles)
    middle = triangles.reshape(-1, 3).mean(axis=0)
    kind = brep["type"] if brep else "free"
    if kind == "plane" and brep:
        axis = np.array(brep["normal"], dtype=float)
        axis *= np.sign(normals.sum(axis=0) @ axis)
        origin = np.array(brep["origin"]) * 1000.0
        return Face(kind="plane", triangles=triangles, origin=origin, axis=axis)
    if kind in ("cylinder", "sphere") and brep:
        place = brep["origin"] if "origin" in brep else brep["center"]
        origin, axis = np.array(place) * 1000.0, np.array(brep.get("axis", [0, 0, 1.0]))
        arms = triangles.mean(axis=1) - origin
        if kind == "cylinder":
            arms = arms - np.outer(arms @ axis, axis)
        return Face(
            kind=kind,
            triangles=triangles,
            origin=origin,
            axis=axis,
            radius_mm=brep["radius"] * 1000.0,
            sign=float(np.sign((normals * arms).sum())),
        )
    axis = normals.mean(axis=0)
    if np.linalg.norm(axis) > 1.0 - 1e-9:
        axis = axis / np.linalg.norm(axis)
        return Face(kind="plane", triangles=triangles, origin=middle, axis=axis)
    return Face(kind="free", triangles=triangles, origin=middle, axis=axis)


def _step_reader(root: Path | None) -> Any:
    import importlib

    try:
        return importlib.import_module("cascadio")
    except ImportError:
        lock = (root or Path()) / "requirements" / "step.lock"
    if not lock.is_file():
        raise InputError(
            "Reading STEP needs the module cascadio, and requirements/step.lock is not there to"
            " install it from. Give the CAD as STL, or install cascadio."
        )
    print("omm: installing the reader for STEP (once, 28 MB) …", file=sys.stderr, flush=True)
    command = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--require-hashes"]
    done = subprocess.run([*command, "-r", str(lock)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["pip failed"])[-1]
        raise InputError(f"The reader for STEP cannot be installed ({last}). Give the CAD as STL.")
    importlib.invalidate_caches()
    return importlib.import_module("cascadio")
