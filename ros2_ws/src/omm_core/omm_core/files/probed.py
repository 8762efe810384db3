"""Probed points: where on the part, and where the machine's probe found them (contract.md)."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.outside import read_text

Array = NDArray[np.float64]

_PART = ("part_x_mm", "part_y_mm", "part_z_mm")
_MACHINE = ("x_mm", "y_mm", "z_mm")
_SIGMA = "sigma_mm"


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbedPoint:
    """One touch.

    Attributes
    ----------
    part_mm : (3,) array
        Where it is on the part, part frame.
    machine_mm : (3,) array or None
        Where the probe found it, machine frame; None where it has not been probed yet.
    sigma_mm : float or None
        Of the probing, each axis; None where not told.
    """

    name: str
    part_mm: Array
    machine_mm: Array | None
    sigma_mm: float | None = None


def load_probed(path: Path, *, probed: bool = True) -> tuple[ProbedPoint, ...]:
    """Read probed points; a name may stand several times, once for each touch.

    Parameters
    ----------
    probed : bool
        Whether the machine's coordinates must be there.

    Raises
    ------
    InputError
        Where the file cannot be read, lacks a column, or holds what is no number.
    """
    text = read_text(path, "file of probed points")
    try:
        reader = csv.DictReader(io.StringIO(text, newline=""), skipinitialspace=True)
        rows = list(reader)
    except csv.Error as error:
        raise InputError(f"The probed points {path} cannot be read: {error}.") from None
    columns = reader.fieldnames or []
    wanted = ("name", *_PART, *(_MACHINE if probed else ()))
    missing = [name for name in wanted if name not in columns]
    if missing or not rows:
        what = f"the column {missing[0]}" if missing else "a line for each touch"
        raise InputError(f"{path}: expected {what} ({','.join(wanted)}[,sigma_mm]), found none.")
    machine = all(name in columns for name in _MACHINE)
    return tuple(
        _point(row, f"{path}, line {number}", machine=machine and probed)
        for number, row in enumerate(rows, start=2)
    )


def probed_csv(points: tuple[ProbedPoint, ...]) -> str:
    """Return probed points as the file that `load_probed` reads."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["name", *_PART, *_MACHINE, _SIGMA])
    for point in points:
        machine = ["", "", ""] if point.machine_mm is None else point.machine_mm.tolist()
        sigma = "" if point.sigma_mm is None else point.sigma_mm
        writer.writerow([point.name, *point.part_mm.tolist(), *machine, sigma])
    return text.getvalue()


def _point(row: dict[str, str], where: str, *, machine: bool) -> ProbedPoint:
    def numbers(names: tuple[str, ...]) -> Array:
        return np.array([_number(row[name], where, name) for name in names])

    sigma = None
    if (row.get(_SIGMA) or "").strip():
        sigma = _number(row[_SIGMA], where, _SIGMA)
        if sigma < 0.0:
            raise InputError(f"{where}: expected sigma_mm >= 0, got {sigma}.")
    if not (row["name"] or "").strip():
        raise InputError(f"{where}: expected a name, got none.")
    return ProbedPoint(
        name=row["name"].strip(),
        part_mm=numbers(_PART),
        machine_mm=numbers(_MACHINE) if machine else None,
        sigma_mm=sigma,
    )


def _number(word: str | None, where: str, name: str) -> float:
    try:
        value = float(word) if word is not None else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: expected a number for {name}, got {word!r}.")
    return value
