"""Faces out of STEP: planes, cylinders, cones, spheres and tori as what they are.

The geometry is read by cascadio (Open CASCADE), which is installed when the first STEP file is
read, and never for those who have none. It tells each face's surface and its triangles, in
metres; free-form faces are known by their triangles and their normals at the corners.
"""

from __future__ import annotations

import json
import struct
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.overstock.face import Face
from omm_core.overstock.step_reader import step_reader
from omm_core.overstock.step_text import StepWords, read_words
from omm_core.overstock.triangles import triangle_areas, triangle_normals

Array = NDArray[np.float64]
CHORD_MM = 0.02
# What remains of the chord's error once the corners' normals tell the bulge.
REMAINS = 0.1
MM_PER_M = 1000.0
LARGEST_BYTES = 300 << 20


def faces_of_step(path: Path, root: Path | None) -> tuple[Face, ...]:
    """Read the faces of one part; ``root`` holds requirements/step.lock.

    Raises
    ------
    InputError
        Where the file is not STEP, is an assembly, or the reader cannot be installed.
    """
    words = _words(path)
    reader = step_reader(root)
    faces = _triangulated(path, words, reader)
    told = [(w.kind, w.label, w.colour) for w in words.faces]
    # Both readers go through the shells in the file's order; where they do not agree, the
    # names and colours stay unknown.
    if [kind for kind, _, _ in told] == [face.kind for face in faces]:
        faces = [
            replace(face, label=label, colour=colour)
            for face, (_, label, colour) in zip(faces, told, strict=True)
        ]
    return tuple(faces)


def _words(path: Path) -> StepWords:
    if path.stat().st_size > LARGEST_BYTES:
        raise InputError(
            f"{path}: expected STEP of at most {LARGEST_BYTES >> 20} MB,"
            f" got {path.stat().st_size / 1e6:.0f} MB. Export the one part alone."
        )
    text = path.read_bytes().decode("latin-1")
    if "ISO-10303-21" not in text[:2000]:
        raise InputError(f"{path}: expected STEP, which begins ISO-10303-21, got something else.")
    words = read_words(text)
    if words.placed_parts or words.bodies > 1:
        what = f"{words.placed_parts} placed parts" if words.placed_parts else "several bodies"
        raise InputError(
            f"{path}: expected one finished part in its own frame, got an assembly or {what}"
            f" ({max(words.bodies, 1)} bodies). Export the part alone."
        )
    return words


def _triangulated(path: Path, words: StepWords, reader: Any) -> list[Face]:
    with tempfile.TemporaryDirectory() as folder:
        given, out = Path(folder) / "part.step", Path(folder) / "part.glb"
        given.write_bytes(words.without_presentation.encode("latin-1"))
        status = reader.step_to_glb(
            str(given), str(out), tol_linear=CHORD_MM, tol_angular=0.2, include_brep=True
        )
        if status != 0 or not out.is_file():
            raise InputError(f"{path} cannot be read as STEP (the reader says {status}).")
        data = out.read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    head, body = json.loads(data[20 : 20 + size]), data[28 + size :]
    primitives = [p for mesh in head.get("meshes", []) for p in mesh["primitives"]]
    if not primitives:
        raise InputError(f"{path}: expected a part with faces, got none.")
    faces: list[Face] = []
    for primitive in primitives:
        faces += _of_primitive(head, body, primitive)
    return faces


def _of_primitive(head: dict[str, Any], body: bytes, primitive: dict[str, Any]) -> list[Face]:
    places = _accessor(head, body, primitive["attributes"]["POSITION"]).reshape(-1, 3)
    corners = _accessor(head, body, primitive["indices"]).reshape(-1, 3).astype(int)
    triangles = (places.astype(np.float64) * MM_PER_M)[corners]
    told = _accessor(head, body, primitive["attributes"]["NORMAL"]).reshape(-1, 3)
    own = told.astype(np.float64)[corners]
    brep = primitive.get("extensions", {}).get("TM_brep_faces")
    if brep is None:
        raise InputError("The STEP reader does not give the faces' surfaces. Give the CAD as STL.")
    numbers = _accessor(head, body, brep["faceIndices"]).astype(int)
    known = {face["face_index"]: face for face in brep["faces"] if face}
    return [
        _face(triangles[numbers == n], own[numbers == n], known.get(int(n)))
        for n in np.unique(numbers)
    ]


def _accessor(head: dict[str, Any], body: bytes, number: int) -> NDArray[Any]:
    accessor = head["accessors"][number]
    view = head["bufferViews"][accessor["bufferView"]]
    kind = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[accessor["componentType"]]
    count = accessor["count"] * {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return np.frombuffer(body, dtype=kind, count=count, offset=start)


def _face(triangles: Array, corner_normals: Array, brep: dict[str, Any] | None) -> Face:
    normals, areas = triangle_normals(triangles), triangle_areas(triangles)
    kind = brep["type"] if brep else "free"
    if brep is None or kind not in ("plane", "cylinder", "cone", "sphere", "torus"):
        return Face(
            kind="free",
            triangles=triangles,
            origin=triangles.reshape(-1, 3).mean(axis=0),
            axis=normals.mean(axis=0),
            chord_mm=REMAINS * CHORD_MM,
            corner_normals=corner_normals,
        )
    place = next(brep[key] for key in ("origin", "apex", "center") if key in brep)
    origin = np.array(place, dtype=float) * MM_PER_M
    axis = np.array(brep.get("normal", brep.get("axis", [0.0, 0.0, 1.0])), dtype=float)
    outward = (normals * areas[:, None]).sum(axis=0)
    if kind == "plane":
        axis = axis if outward @ axis > 0.0 else -axis
        return Face(kind=kind, triangles=triangles, origin=origin, axis=axis)
    if kind == "cone" and (triangles.reshape(-1, 3).mean(axis=0) - origin) @ axis < 0.0:
        axis = -axis
    face = Face(
        kind=kind,
        triangles=triangles,
        origin=origin,
        axis=axis,
        radius_mm=float(brep.get("minor_radius", brep.get("radius", 0.0))) * MM_PER_M,
        ring_radius_mm=float(brep.get("major_radius", 0.0)) * MM_PER_M,
        half_angle_rad=abs(float(brep.get("semi_angle", 0.0))),
    )
    _, ideal = face.distance(triangles.mean(axis=1))
    inside = ((ideal * normals).sum(axis=1) * areas).sum() < 0.0
    return replace(face, sign=-1.0) if inside else face
