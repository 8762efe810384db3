"""True-to-scale sheets of ring-coded targets as vector PDF."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from omm_core.errors import InputError
from omm_core.targets.coded.families import TargetFamily

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
QUIET_RATIO = 0.6
"""Clear band around the ring, in dot radii."""
CUT_MARK_MM = 3.0
TEXT_MM = 2.2
_ARC_STEP_RAD = math.radians(0.5)


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """What is printed.

    Attributes
    ----------
    dot_mm : diameter of the dot.
    white_on_black : True for bright dots on black (film on retroreflective sheet), False for
        black dots on white.
    """

    family: TargetFamily
    ids: tuple[int, ...]
    dot_mm: float
    paper: str = "A4"
    white_on_black: bool = True

    def __post_init__(self) -> None:
        if self.paper not in PAPERS_MM:
            raise InputError(f"Expected a paper out of {', '.join(PAPERS_MM)}, got {self.paper!r}.")
        if not (math.isfinite(self.dot_mm) and self.dot_mm > 0.0):
            raise InputError(f"Expected a dot diameter above 0 mm, got {self.dot_mm}.")
        if not self.ids:
            raise InputError("Expected numbers of targets to print, got none.")
        for target_id in self.ids:
            self.family.code_of(target_id)
        width, height = self.usable_mm
        if self.cell_mm > width or self.cell_mm > height:
            raise InputError(
                f"Targets with a dot of {self.dot_mm:g} mm need {self.cell_mm:.0f} mm, the paper "
                f"{self.paper} has {min(width, height):.0f} mm: take larger paper or smaller dots."
            )

    @property
    def square_mm(self) -> float:
        """Side of the square that is cut out."""
        return self.dot_mm * (self.family.ring_outer_ratio + QUIET_RATIO)

    @property
    def cell_mm(self) -> float:
        """Pitch of the targets on the paper: square, cutting marks and number."""
        return self.square_mm + 2.0 * CUT_MARK_MM + TEXT_MM + 2.0

    @property
    def usable_mm(self) -> tuple[float, float]:
        """Width and height within the margins and above the footer."""
        width, height = PAPERS_MM[self.paper]
        return width - 2.0 * MARGIN_MM, height - 2.0 * MARGIN_MM - FOOTER_MM

    def places_mm(self) -> list[tuple[int, int, float, float]]:
        """Return (id, page from 0, x, y of the dot's centre from the paper's top-left corner)."""
        columns = int(self.usable_mm[0] / self.cell_mm)
        rows = int(self.usable_mm[1] / self.cell_mm)
        places = []
        for index, target_id in enumerate(self.ids):
            page, place = divmod(index, columns * rows)
            row, column = divmod(place, columns)
            places.append(
                (
                    target_id,
                    page,
                    MARGIN_MM + (column + 0.5) * self.cell_mm,
                    MARGIN_MM + (row + 0.5) * self.cell_mm,
                )
            )
        return places


def ring_polygons(
    family: TargetFamily, code: int, dot_radius_mm: float
) -> list[list[tuple[float, float]]]:
    """Return the outlines of the ring's set arcs (mm, x right, y down, about the dot's centre).

    Neighbouring set sectors are one outline: no hair line between them.
    """
    n = family.bits
    inner, outer = family.ring_inner_ratio * dot_radius_mm, family.ring_outer_ratio * dot_radius_mm
    bits = [(code >> (n - 1 - i)) & 1 for i in range(n)]
    pitch = 2.0 * math.pi / n
    polygons = []
    for first in range(n):
        if not bits[first] or bits[first - 1]:
            continue
        length = 1
        while bits[(first + length) % n]:
            length += 1
        steps = max(2, math.ceil(length * pitch / _ARC_STEP_RAD))
        # Twelve o'clock is where the first bit begins; clockwise on paper.
        angles = np.linspace(first, first + length, steps + 1) * pitch - 0.5 * math.pi
        outside = [(outer * math.cos(a), outer * math.sin(a)) for a in angles]
        inside = [(inner * math.cos(a), inner * math.sin(a)) for a in angles[::-1]]
        polygons.append(outside + inside)
    return polygons


def write_pdf(sheet: Sheet, path: str | Path) -> int:
    """Write the sheet and return its number of pages.

    Raises
    ------
    InputError
        If fpdf2 is missing or the file cannot be written.
    """
    try:
        from fpdf import FPDF
    except ImportError as error:
        raise InputError("Printing needs the Python package fpdf2: pip install fpdf2") from error
    pdf = FPDF(unit="mm", format=PAPERS_MM[sheet.paper])
    pdf.set_auto_page_break(False)
    pdf.set_title(f"{sheet.family.name}, dots of {sheet.dot_mm:g} mm")
    places = sheet.places_mm()
    pages = places[-1][1] + 1
    for page in range(pages):
        pdf.add_page()
        _footer(pdf, sheet, page, pages)
        for target_id, on_page, x, y in places:
            if on_page == page:
                _target(pdf, sheet, target_id, x, y)
    try:
        pdf.output(str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    return pages


def _target(pdf, sheet: Sheet, target_id: int, x: float, y: float) -> None:  # type: ignore[no-untyped-def]
    radius = 0.5 * sheet.dot_mm
    half = 0.5 * sheet.square_mm
    mark, ground = (255, 0) if sheet.white_on_black else (0, 255)
    if sheet.white_on_black:
        pdf.set_fill_color(ground)
        pdf.rect(x - half, y - half, 2.0 * half, 2.0 * half, style="F")
    pdf.set_fill_color(mark)
    pdf.ellipse(x - radius, y - radius, 2.0 * radius, 2.0 * radius, style="F")
    code = sheet.family.code_of(target_id)
    for polygon in ring_polygons(sheet.family, code, radius):
        pdf.polygon([(x + px, y + py) for px, py in polygon], style="F")
    pdf.set_draw_color(0)
    pdf.set_line_width(0.1)
    gap = 0.5
    for sx in (-1, 1):
        for sy in (-1, 1):
            cx, cy = x + sx * half, y + sy * half
            pdf.line(cx + sx * gap, cy, cx + sx * CUT_MARK_MM, cy)
            pdf.line(cx, cy + sy * gap, cx, cy + sy * CUT_MARK_MM)
    _text(pdf, x, y + half + CUT_MARK_MM - 0.8, f"{sheet.family.name}  {target_id}", centred=True)


def _footer(pdf, sheet: Sheet, page: int, pages: int) -> None:  # type: ignore[no-untyped-def]
    width, height = PAPERS_MM[sheet.paper]
    length = 100.0 if width - 2.0 * MARGIN_MM >= 100.0 else 50.0
    x, y = MARGIN_MM, height - MARGIN_MM
    pdf.set_draw_color(0)
    pdf.set_line_width(0.2)
    pdf.line(x, y, x + length, y)
    for tick in range(int(length / 10.0) + 1):
        pdf.line(x + 10.0 * tick, y - (3.0 if tick % 5 == 0 else 1.5), x + 10.0 * tick, y)
    _text(pdf, x, y + 2.6, f"{length:g} mm between the outer ticks: measure it, print at 100 %")
    _text(
        pdf, x, y - 5.0, f"{sheet.family.name}, dot {sheet.dot_mm:g} mm, page {page + 1} of {pages}"
    )


def _text(pdf, x: float, y: float, text: str, *, centred: bool = False) -> None:  # type: ignore[no-untyped-def]
    pdf.set_font("Helvetica", size=TEXT_MM / 25.4 * 72.0)
    pdf.set_text_color(0)
    pdf.text(x - (0.5 * pdf.get_string_width(text) if centred else 0.0), y, text)


_LARGEST_ID = 100_000
"""More than any family has."""


def parse_ids(text: str | Sequence[str]) -> tuple[int, ...]:
    """Read numbers such as ``1-10,15,20-25``.

    Raises
    ------
    InputError
        If it is not a list of numbers and ranges.
    """
    parts = (text if isinstance(text, str) else ",".join(text)).replace(" ", ",").split(",")
    ids: list[int] = []
    for part in filter(None, parts):
        first, dash, last = part.partition("-")
        try:
            start = int(first)
            end = int(last) if dash else start
            if not 0 <= start <= end <= _LARGEST_ID:
                raise ValueError
            ids.extend(range(start, end + 1))
        except ValueError as error:
            raise InputError(
                f"Expected numbers and ranges such as 1-10,15, got {part[:80]!r}."
            ) from error
    return tuple(dict.fromkeys(ids))
