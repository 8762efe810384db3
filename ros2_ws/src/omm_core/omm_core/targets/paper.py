"""Sheets of paper, true to scale: places on a grid, cutting marks, a bar to measure."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from omm_core.errors import InputError

PAPERS_MM = {
    "A5": (148.0, 210.0),
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
    "legal": (215.9, 355.6),
    "tabloid": (279.4, 431.8),
}
MARGIN_MM = 12.0
FOOTER_MM = 14.0
CUT_MARK_MM = 3.0
TEXT_MM = 2.2
_GAP_MM = 0.5

Place = tuple[int, float, float]
"""Page from 0; x, y from the paper's top-left corner, mm."""


def refuse_unfit(paper: str, dot_mm: float, cell_mm: float) -> None:
    """Refuse paper that is unknown, or too small for one target.

    Raises
    ------
    InputError
    """
    if paper not in PAPERS_MM:
        raise InputError(f"Expected a paper out of {', '.join(PAPERS_MM)}, got {paper!r}.")
    if not (math.isfinite(dot_mm) and dot_mm > 0.0):
        raise InputError(f"Expected a dot diameter above 0 mm, got {dot_mm}.")
    room = min(_usable_mm(paper))
    if cell_mm > room:
        raise InputError(
            f"Targets with a dot of {dot_mm:g} mm need {cell_mm:.0f} mm, the paper "
            f"{paper} has {room:.0f} mm: take larger paper or smaller dots."
        )


def grid_mm(paper: str, cell_mm: float, count: int) -> list[Place]:
    """Return where targets stand, row by row, as many pages as they need."""
    width, height = _usable_mm(paper)
    columns, rows = int(width / cell_mm), int(height / cell_mm)
    places = []
    for index in range(count):
        page, place = divmod(index, columns * rows)
        row, column = divmod(place, columns)
        x, y = ((at + 0.5) * cell_mm + MARGIN_MM for at in (column, row))
        places.append((page, x, y))
    return places


def write_sheets(
    path: str | Path, paper: str, title: str, places: list[Place], draw: Callable[..., None]
) -> int:
    """Write a PDF and return its number of pages.

    Parameters
    ----------
    title : str
        Of the document, and in the footer of each page.
    draw : callable
        (pdf, index of the place, x, y) draws one target.

    Raises
    ------
    InputError
        If fpdf2 is missing or the file cannot be written.
    """
    try:
        from fpdf import FPDF
    except ImportError as error:
        raise InputError("Printing needs the Python package fpdf2: pip install fpdf2") from error
    pdf = FPDF(unit="mm", format=PAPERS_MM[paper])
    pdf.set_auto_page_break(False)
    pdf.set_title(title)
    pages = places[-1][0] + 1
    for page in range(pages):
        pdf.add_page()
        _footer(pdf, PAPERS_MM[paper], f"{title}, page {page + 1} of {pages}")
        for index, (on_page, x, y) in enumerate(places):
            if on_page == page:
                draw(pdf, index, x, y)
    try:
        pdf.output(str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    return pages


def draw_dot(pdf: Any, x: float, y: float, radius: float, half: float, *, white: bool) -> None:
    """Draw a dot on its ground, a square of half the side ``half``; the mark's colour stays set."""
    if white:
        pdf.set_fill_color(0)
        pdf.rect(x - half, y - half, 2.0 * half, 2.0 * half, style="F")
    pdf.set_fill_color(255 if white else 0)
    pdf.ellipse(x - radius, y - radius, 2.0 * radius, 2.0 * radius, style="F")


def draw_cut_marks(pdf: Any, x: float, y: float, half: float) -> None:
    """Draw where the square around x, y is cut out."""
    pdf.set_draw_color(0)
    pdf.set_line_width(0.1)
    for sx in (-1, 1):
        for sy in (-1, 1):
            cx, cy = x + sx * half, y + sy * half
            pdf.line(cx + sx * _GAP_MM, cy, cx + sx * CUT_MARK_MM, cy)
            pdf.line(cx, cy + sy * _GAP_MM, cx, cy + sy * CUT_MARK_MM)


def draw_axis(pdf: Any, x: float, y: float, half: float) -> None:
    """Draw the axis of a scale bar through x, y, beside the square: left and right of it."""
    pdf.set_draw_color(0)
    pdf.set_line_width(0.1)
    for side in (-1, 1):
        pdf.line(x + side * (half + _GAP_MM), y, x + side * (half + CUT_MARK_MM), y)


def draw_text(pdf: Any, x: float, y: float, text: str, *, centred: bool = False) -> None:
    """Write a line of text."""
    pdf.set_font("Helvetica", size=TEXT_MM / 25.4 * 72.0)
    pdf.set_text_color(0)
    pdf.text(x - (0.5 * pdf.get_string_width(text) if centred else 0.0), y, text)


def _usable_mm(paper: str) -> tuple[float, float]:
    """Return width and height within the margins and above the footer."""
    width, height = PAPERS_MM[paper]
    return width - 2.0 * MARGIN_MM, height - 2.0 * MARGIN_MM - FOOTER_MM


def _footer(pdf: Any, paper_mm: tuple[float, float], title: str) -> None:
    width, height = paper_mm
    length = 100.0 if width - 2.0 * MARGIN_MM >= 100.0 else 50.0
    x, y = MARGIN_MM, height - MARGIN_MM
    pdf.set_draw_color(0)
    pdf.set_line_width(0.2)
    pdf.line(x, y, x + length, y)
    for tick in range(int(length / 10.0) + 1):
        pdf.line(x + 10.0 * tick, y - (3.0 if tick % 5 == 0 else 1.5), x + 10.0 * tick, y)
    draw_text(pdf, x, y + 2.6, f"{length:g} mm between the outer ticks: measure it, print at 100 %")
    draw_text(pdf, x, y - 5.0, title)
