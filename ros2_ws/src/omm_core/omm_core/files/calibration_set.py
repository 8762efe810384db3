"""Read set.yaml: what a camera is calibrated from (contract, "Files")."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.csv_input import read_table
from omm_core.files.declared import (
    direction,
    expect_once,
    file,
    integer,
    number,
    part_of,
    read_section,
    text,
)
from omm_core.files.yaml_input import YamlSection, read_yaml

Array = NDArray[np.float64]

_ROOT = ("kind", "model")
_PIXELS_MM = (1e-4, 0.2)
_PLACE = ("x_mm", "y_mm", "z_mm")
_CENTRE = ("col_px", "row_px")


@dataclass(frozen=True, kw_only=True)
class SetCamera:
    """The sensor, as the set names it."""

    name: Annotated[str, text()]
    width_px: Annotated[int, integer(minimum=16)]
    height_px: Annotated[int, integer(minimum=16)]
    pixel_size_mm: Annotated[float, number(above=0.0)]


@dataclass(frozen=True, kw_only=True, eq=False)
class DotOfSet:
    """The one dot of a ``cmm`` set; its normal (3,) in the taper's axes."""

    dot_diameter_mm: Annotated[float, number(above=0.0)]
    normal: Annotated[Array, direction()]


@dataclass(frozen=True, kw_only=True, eq=False)
class CmmSet:
    """A plain dot at known places (taper frame).

    ``pixels`` is None where the dot is to be found in the images; ``sigma_px`` then as well.
    """

    path: Path
    camera: Annotated[SetCamera, part_of(SetCamera)]
    images: tuple[str, ...]
    places_mm: Array
    pixels: Array | None
    target: Annotated[DotOfSet, part_of(DotOfSet)]
    sigma_px: Annotated[float | None, number(above=0.0)] = None
    sigma_xyz_mm: Annotated[float, number(least=0.0)]
    nominal: Annotated[Path | None, file()] = None
    temperature_C: Annotated[float | None, number()] = None


@dataclass(frozen=True, kw_only=True)
class Touched:
    """A probed height of a target's dot, machine coordinates."""

    target: Annotated[int, integer(minimum=1)]
    z_mm: Annotated[float, number()]
    sigma_mm: Annotated[float, number(above=0.0)]


@dataclass(frozen=True, kw_only=True)
class MachineSet:
    """A run over a plate of coded targets that stood still."""

    path: Path
    camera: Annotated[SetCamera, part_of(SetCamera)]
    run: Annotated[Path, file()]
    part: Annotated[Path, file()]
    machine_sigma_mm: Annotated[float, number(above=0.0)]
    touched: Annotated[Touched | None, part_of(Touched)] = None
    nominal: Annotated[Path | None, file()] = None
    temperature_C: Annotated[float | None, number()] = None


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
    _check_pixel(path, root)
    kind = root.text("kind")
    if kind == "machine":
        return read_section(MachineSet, root, also=_ROOT, path=path)
    if kind == "cmm":
        return _cmm(path, root)
    raise InputError(f"{path}: expected the kind 'cmm' or 'machine', got '{kind}'.")


def _check_pixel(path: Path, root: YamlSection) -> None:
    """Raise InputError for a pixel in another unit: the focal length would be, too."""
    size = root.section("camera").number("pixel_size_mm")
    smallest, largest = _PIXELS_MM
    if not smallest <= size <= largest:
        raise InputError(
            f"{path}: expected a pixel of {smallest:g} to {largest:g} mm, got pixel_size_mm:"
            f" {size:g}. 2.2 µm are 0.0022 mm."
        )


def _cmm(path: Path, root: YamlSection) -> CmmSet:
    images, places, pixels = _points(path.parent / root.text("points"))
    if pixels is not None:
        root.get("sigma_px")
    return read_section(
        CmmSet,
        root,
        also=(*_ROOT, "points"),
        path=path,
        images=images,
        places_mm=places,
        pixels=pixels,
    )


def _points(path: Path) -> tuple[tuple[str, ...], Array, Array | None]:
    table = read_table(path, "table of points", ("image", *_PLACE), each="image")
    images = tuple(row.text("image") for row in table.rows)
    expect_once(images, str(path), "image")
    places = np.array([row.numbers(_PLACE) for row in table.rows])
    if not table.has(*_CENTRE):
        return images, places, None
    return images, places, np.array([row.numbers(_CENTRE) for row in table.rows])
