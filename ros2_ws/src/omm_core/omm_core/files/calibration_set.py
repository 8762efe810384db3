"""Read set.yaml: what a camera is calibrated from (contract, "Files")."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.outside import read_text
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]


_KEYS = {
    "cmm": ("points", "target", "sigma_xyz_mm", "sigma_px"),
    "machine": ("run", "part", "machine_sigma_mm", "touched"),
}


@dataclass(frozen=True, kw_only=True)
class SetCamera:
    """The sensor, as the set names it."""

    name: str
    width_px: int
    height_px: int
    pixel_size_mm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class CmmSet:
    """A plain dot at known places (taper frame).

    ``pixels`` is None where the dot is to be found in the images; ``sigma_px`` then as well.
    """

    path: Path
    camera: SetCamera
    images: tuple[str, ...]
    places_mm: Array
    pixels: Array | None
    sigma_px: float | None
    sigma_xyz_mm: float
    dot_diameter_mm: float
    normal: Array
    nominal: Path | None


@dataclass(frozen=True, kw_only=True)
class Touched:
    """A probed height of a target's dot, machine coordinates."""

    target: int
    z_mm: float
    sigma_mm: float


@dataclass(frozen=True, kw_only=True)
class MachineSet:
    """A run over a plate of coded targets that stood still."""

    path: Path
    camera: SetCamera
    run: Path
    part: Path
    machine_sigma_mm: float
    touched: Touched | None
    nominal: Path | None


def load_calibration_set(path: Path) -> CmmSet | MachineSet:
    """Read a set.yaml, or the one in a folder.

    Raises
    ------
    InputError
        Where a file is missing or malformed.
    """
    path = path / "set.yaml" if path.is_dir() else path
    root = read_yaml(path, "calibration set")
    model = root.text("model")
    if model != "brown_photogrammetric":
        raise InputError(
            f"{path}: expected the model 'brown_photogrammetric', got '{model}'. Calibrate with it;"
            " live, both models are understood."
        )
    kind = root.text("kind")
    own = _KEYS.get(kind, ())
    root.warn_unknown("kind", "camera", "model", "nominal", *own)
    if kind == "cmm":
        return _cmm(path, root)
    if kind == "machine":
        return _machine(path, root)
    raise InputError(f"{path}: expected the kind 'cmm' or 'machine', got '{kind}'.")


def _camera(root: YamlSection) -> SetCamera:
    camera = root.section("camera")
    camera.warn_unknown("name", "width_px", "height_px", "pixel_size_mm")
    return SetCamera(
        name=camera.text("name"),
        width_px=camera.integer("width_px", minimum=16),
        height_px=camera.integer("height_px", minimum=16),
        pixel_size_mm=camera.number("pixel_size_mm", above=0.0),
    )


def _nominal(path: Path, root: YamlSection) -> Path | None:
    return path.parent / root.text("nominal") if "nominal" in root else None


def _machine(path: Path, root: YamlSection) -> MachineSet:
    touched = None
    if "touched" in root:
        section = root.section("touched")
        section.warn_unknown("target", "z_mm", "sigma_mm")
        touched = Touched(
            target=section.integer("target", minimum=1),
            z_mm=section.number("z_mm"),
            sigma_mm=section.number("sigma_mm", above=0.0),
        )
    return MachineSet(
        path=path,
        camera=_camera(root),
        run=path.parent / root.text("run"),
        part=path.parent / root.text("part"),
        machine_sigma_mm=root.number("machine_sigma_mm", above=0.0),
        touched=touched,
        nominal=_nominal(path, root),
    )


def _cmm(path: Path, root: YamlSection) -> CmmSet:
    target = root.section("target")
    target.warn_unknown("dot_diameter_mm", "normal")
    normal = target.numbers("normal", 3)
    if np.linalg.norm(normal) < 1e-6:
        raise InputError(f"{target.where}: expected a normal with a direction, got {normal}.")
    images, places, pixels = _points(path.parent / root.text("points"))
    return CmmSet(
        path=path,
        camera=_camera(root),
        images=images,
        places_mm=places,
        pixels=pixels,
        sigma_px=None if pixels is None else root.number("sigma_px", above=0.0),
        sigma_xyz_mm=root.number("sigma_xyz_mm", above=-1e-12),
        dot_diameter_mm=target.number("dot_diameter_mm", above=0.0),
        normal=normal / np.linalg.norm(normal),
        nominal=_nominal(path, root),
    )


def _points(path: Path) -> tuple[tuple[str, ...], Array, Array | None]:
    text = read_text(path, "table of points")
    try:
        rows = list(csv.DictReader(io.StringIO(text, newline="")))
    except csv.Error as error:
        raise InputError(f"The points {path} cannot be read: {error}.") from None
    if not rows:
        raise InputError(f"{path}: expected one line for each image, got none.")
    wanted = ["image", "x_mm", "y_mm", "z_mm"]
    missing = [name for name in wanted if name not in rows[0]]
    if missing:
        raise InputError(f"{path}: the column {missing[0]} is missing (expected {wanted}).")
    measured = "col_px" in rows[0] and "row_px" in rows[0]
    names = wanted[1:] + (["col_px", "row_px"] if measured else [])
    numbers = np.array([[_number(path, i, row, n) for n in names] for i, row in enumerate(rows, 2)])
    images = tuple(row["image"] for row in rows)
    twice = sorted(name for name, number in Counter(images).items() if number > 1)
    if twice:
        raise InputError(f"{path}: expected each image once, got {twice[0]} more than once.")
    return images, numbers[:, :3], numbers[:, 3:] if measured else None


def _number(path: Path, line: int, row: dict[str, str], name: str) -> float:
    try:
        value = float(row[name])
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{path}, line {line}: expected a number for {name}, got '{row[name]}'.")
    return value
