"""True-to-scale sheets of plain dots as vector PDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omm_core.errors import InputError
from omm_core.targets import paper as sheets

SQUARE_RATIO = 2.5
"""Side of the square that is cut out, in dot diameters."""
MOST_DOTS = 20_000
"""More than any part takes."""


@dataclass(frozen=True, kw_only=True)
class PlainSheet:
    """What is printed.

    Attributes
    ----------
    count : number of dots.
    dot_mm : their diameter.
    white_on_black : True for bright dots on black, False for black dots on white.
    """

    count: int
    dot_mm: float
    paper: str = "A4"
    white_on_black: bool = True

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MOST_DOTS:
            raise InputError(f"Expected 1 to {MOST_DOTS} plain targets, got {self.count}.")
        sheets.refuse_unfit(self.paper, self.dot_mm, self.cell_mm)

    @property
    def square_mm(self) -> float:
        """Side of the square that is cut out."""
        return self.dot_mm * SQUARE_RATIO

    @property
    def cell_mm(self) -> float:
        """Pitch of the targets on the paper: square and cutting marks."""
        return self.square_mm + 2.0 * sheets.CUT_MARK_MM + 1.0

    def places_mm(self) -> list[sheets.Place]:
        """Return (page from 0, x, y of the dot's centre from the paper's top-left corner)."""
        return sheets.grid_mm(self.paper, self.cell_mm, self.count)


def write_pdf(sheet: PlainSheet, path: str | Path) -> int:
    """Write the sheet and return its number of pages.

    Raises
    ------
    InputError
        If fpdf2 is missing or the file cannot be written.
    """

    def draw(pdf: Any, index: int, x: float, y: float) -> None:
        half = 0.5 * sheet.square_mm
        sheets.draw_dot(pdf, x, y, 0.5 * sheet.dot_mm, half, white=sheet.white_on_black)
        sheets.draw_cut_marks(pdf, x, y, half)

    title = f"plain targets, dot {sheet.dot_mm:g} mm"
    return sheets.write_sheets(path, sheet.paper, title, sheet.places_mm(), draw)
