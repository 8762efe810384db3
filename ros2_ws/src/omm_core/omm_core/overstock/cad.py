"""Faces of the finished part out of STEP, STL or PLY."""

from __future__ import annotations

from pathlib import Path

from omm_core.errors import InputError
from omm_core.overstock.face import Face
from omm_core.overstock.mesh_file import faces_of_mesh
from omm_core.overstock.step_file import faces_of_step


def load_faces(path: Path, root: Path | None = None, unit_mm: float = 1.0) -> tuple[Face, ...]:
    """Read the faces of a part; ``root`` holds requirements/step.lock.

    ``unit_mm`` is the unit of STL and PLY, which do not tell theirs; STEP does.

    Raises
    ------
    InputError
        Where the file cannot be read or the optional STEP reader cannot be installed.
    """
    if not path.is_file():
        raise InputError(f"Expected the CAD at {path}, but there is no such file.")
    if path.suffix.lower() in (".step", ".stp"):
        return faces_of_step(path, root)
    if path.suffix.lower() in (".stl", ".ply"):
        return faces_of_mesh(path, unit_mm)
    raise InputError(f"{path}: expected STEP, STL or PLY, got '{path.suffix}'.")
