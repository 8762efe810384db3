"""A network as AICON 3D Studio exports it: image points, orientations, camera, points, bars.

Five text files of one name:

- ``.phc``: image, point, x, y (mm), σ x, σ y, v x, v y, three flags (1 1 1: used);
- ``.eor``: image, camera, X Y Z (mm), ω φ κ (rad; Rx(ω) Ry(φ) Rz(κ) takes camera to object);
- ``.ior``: camera, number, c, x0, y0, A1, A2, R0 / A3 / B1 B2 / C1 C2 / sensor (mm, pixels);
- ``.obc``: point, X Y Z (mm), ...;
- ``.scale``: number, name, ends, length, σ (mm), used.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.outside import read_text

Array = NDArray[np.float64]
Rows = list[list[str]]


@dataclass(frozen=True, kw_only=True, eq=False)
class AiconNetwork:
    """The network.

    Attributes
    ----------
    image, point : (M,) int arrays
        Numbers of what each used ray connects.
    measured_mm : (M, 2) array
    stations : mapping
        Image -> X Y Z ω φ κ.
    points_mm : mapping
        Point -> X Y Z.
    lens : (10,) array
        c, x0, y0, A1, A2, A3, B1, B2, C1, C2.
    r0_mm : float
    bars : tuple
        (end, end, length, σ), mm.
    """

    image: NDArray[np.intp]
    point: NDArray[np.intp]
    measured_mm: Array
    stations: dict[int, Array]
    points_mm: dict[int, Array]
    lens: Array
    r0_mm: float
    bars: tuple[tuple[int, int, float, float], ...]


def is_aicon(folder: Path) -> bool:
    """Tell whether a folder holds such a network."""
    return folder.is_dir() and bool(list(folder.glob("*.phc")))


def load_aicon(folder: Path) -> AiconNetwork:
    """Read the network in a folder.

    Raises
    ------
    InputError
        Where a file is missing or not as described above.
    """
    found = sorted(folder.glob("*.phc"))
    if len(found) != 1:
        raise InputError(f"{folder}: expected one .phc file, found {len(found)}.")
    base = found[0]
    points = {int(r[0]): _floats(r[1:4]) for r in _rows(base.with_suffix(".obc"), 4)}
    stations = {int(r[0]): _floats(r[2:8]) for r in _rows(base.with_suffix(".eor"), 8)}
    rays = [
        row
        for row in _rows(base, 11)
        if row[8:11] == ["1", "1", "1"] and int(row[1]) in points and int(row[0]) in stations
    ]
    try:
        image, point = (np.array([int(r[i]) for r in rays], dtype=np.intp) for i in (0, 1))
        measured = np.array([_floats(r[2:4]) for r in rays]).reshape(-1, 2)
        lens, r0 = _camera(base.with_suffix(".ior"))
    except ValueError as error:
        raise InputError(f"{base}: expected numbers; {error}.") from None
    return AiconNetwork(
        image=image, point=point, measured_mm=measured, stations=stations, points_mm=points,
        lens=lens, r0_mm=r0, bars=_bars(base.with_suffix(".scale")),
    )  # fmt: skip


def _rows(path: Path, least: int) -> Rows:
    rows = [line.split() for line in read_text(path, "AICON file").splitlines() if line.strip()]
    short = [number for number, row in enumerate(rows, start=1) if len(row) < least]
    if short:
        raise InputError(f"{path}: expected {least} columns, got fewer in row {short[0]}.")
    return rows


def _floats(words: list[str]) -> Array:
    values = np.array([float(word) for word in words])
    if not np.isfinite(values).all():
        raise ValueError(f"got {' '.join(words)}")
    return values


def _camera(path: Path) -> tuple[Array, float]:
    words = read_text(path, "AICON file").split()
    if len(words) < 13:
        raise InputError(f"{path}: expected a camera of 13 numbers or more, got {len(words)}.")
    c, x0, y0, a1, a2, r0, a3, b1, b2, c1, c2 = _floats(words[2:13])
    return np.array([c, x0, y0, a1, a2, a3, b1, b2, c1, c2]), float(r0)


def _bars(path: Path) -> tuple[tuple[int, int, float, float], ...]:
    bars = []
    for line in read_text(path, "AICON file").splitlines():
        words = shlex.split(line)
        if len(words) >= 7 and words[6] == "1":
            bars.append((int(words[2]), int(words[3]), float(words[4]), float(words[5])))
    return tuple(bars)
