"""Everything that a fit is shown by, written where people ask for it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from omm_core.errors import InputError
from omm_core.files.output import write_whole
from omm_core.overstock.cad import load_faces
from omm_core.overstock.fit import Fit
from omm_core.overstock.what_if import WhatIf, rows_of
from omm_report.fit_map import map_of_faces, map_of_fit
from omm_report.fit_picture import faces_figure, overstock_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def show_faces(cad: Path, root: Path, pictures: Path | None) -> None:
    """List the faces of a CAD file with their numbers, and draw them.

    Raises
    ------
    InputError
        Where the CAD cannot be read or the picture cannot be written.
    """
    faces = load_faces(cad, root)
    for number, face in enumerate(faces, start=1):
        colour = f"  {face.colour}" if face.colour else ""
        print(f"{number:4d}  {face.name}{colour}")
    out = (pictures or Path()) / f"{cad.stem}_faces.png"
    write_figure(out, faces_figure(map_of_faces(faces)))
    print(f"drawn in {out}")


def write_pictures(folder: Path, fit: Fit, what_if: WhatIf | None) -> None:
    """Write the colour map of overstock, and that of another wish, as PNG.

    Raises
    ------
    InputError
        Where they cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"Cannot make the folder {folder}: {error.strerror}.") from error
    write_figure(folder / "overstock.png", overstock_figure(map_of_fit(fit)))
    write_figure(folder / "faces.png", faces_figure(map_of_faces(fit.problem.faces)))
    if what_if is not None:
        write_figure(folder / "overstock_what_if.png", overstock_figure(map_of_fit(what_if.fit)))


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure as PNG: the same figure, the same bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    write_whole(path, buffer.getvalue())


def what_if_text(before: Fit, after: WhatIf) -> str:
    """Return both fits side by side, as lines."""
    rows = rows_of(before, after)
    lines = [f"{r[0]:48s} {r[1]:>10s} {r[2]:>10s}  {r[3]:14s} {r[4]}" for r in rows]
    return "\n".join([f"What if: {after.words}", *lines])
