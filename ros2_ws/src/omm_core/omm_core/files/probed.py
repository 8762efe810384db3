"""Probed points: where on the part, and where the machine's probe found them (contract.md)."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.files.csv_input import Row, read_table

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
        Where the file cannot be read, lacks a column, or holds something that is not a number.
    """
    wanted = ("name", *_PART, *(_MACHINE if probed else ()))
    table = read_table(path, "file of probed points", wanted, each="touch")
    return tuple(_point(row, machine=probed) for row in table.rows)


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


def _point(row: Row, *, machine: bool) -> ProbedPoint:
    return ProbedPoint(
        name=row.text("name"),
        part_mm=row.numbers(_PART),
        machine_mm=row.numbers(_MACHINE) if machine else None,
        sigma_mm=row.number(_SIGMA, least=0.0) if row.has(_SIGMA) else None,
    )
