"""True-to-scale sheets of ring-coded targets as vector PDF."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omm_core.errors import InputError
from omm_core.targets import paper as sheets
from omm_core.targets.coded.families import TargetFamily

QUIET_RATIO = 0.6
"""Clear band around the ring, in dot radii."""
_ARC_STEP_RAD = math.radians(0.5)


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """What is printed.

    Attributes
    ----------
    dot_mm : diameter of the dot.
    white_on_black : True for bright dots on black (film on retroreflective sheet), False for
        black dots on white.
    bar_ends : each two targets are the ends of a scale bar: marked with its axis and both numbers.
    """

    family: TargetFamily
    ids: tuple[int, ...]
    dot_mm: float
    paper: str = "A4"
    white_on_black: bool = True
    bar_ends: bool = False

    def __post_init__(self) -> None:
        if not self.ids:
            raise InputError("Expected numbers of targets to print, got none.")
        for target_id in self.ids:
            self.family.code_of(target_id)
        if self.bar_ends and len(self.ids) % 2:
            raise InputError(
                f"Expected an even number of targets, two to each scale bar, got {len(self.ids)}."
            )
        sheets.refuse_unfit(self.paper, self.dot_mm, self.cell_mm)

    @property
    def square_mm(self) -> float:
        """Side of the square that is cut out."""
        return self.dot_mm * (self.family.ring_outer_ratio + QUIET_RATIO)

    @property
    def cell_mm(self) -> float:
        """Pitch of the targets on the paper: square, cutting marks and number."""
        return self.square_mm + 2.0 * sheets.CUT_MARK_MM + sheets.TEXT_MM + 2.0

    @property
    def bars(self) -> tuple[tuple[int, int], ...]:
        """Numbers of the two ends of each scale bar."""
        return tuple(zip(self.ids[::2], self.ids[1::2], strict=True)) if self.bar_ends else ()

    def places_mm(self) -> list[tuple[int, int, float, float]]:
        """Return (id, page from 0, x, y of the dot's centre from the paper's top-left corner)."""
        places = sheets.grid_mm(self.paper, self.cell_mm, len(self.ids))
        return [(number, *place) for number, place in zip(self.ids, places, strict=True)]


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

    def draw(pdf: Any, index: int, x: float, y: float) -> None:
        _target(pdf, sheet, index, x, y)

    title = f"{sheet.family.name}, dot {sheet.dot_mm:g} mm"
    places = sheets.grid_mm(sheet.paper, sheet.cell_mm, len(sheet.ids))
    return sheets.write_sheets(path, sheet.paper, title, places, draw)


def _target(pdf: Any, sheet: Sheet, index: int, x: float, y: float) -> None:
    radius, half = 0.5 * sheet.dot_mm, 0.5 * sheet.square_mm
    number = sheet.ids[index]
    sheets.draw_dot(pdf, x, y, radius, half, white=sheet.white_on_black)
    for polygon in ring_polygons(sheet.family, sheet.family.code_of(number), radius):
        pdf.polygon([(x + px, y + py) for px, py in polygon], style="F")
    sheets.draw_cut_marks(pdf, x, y, half)
    words = f"{sheet.family.name}  {number}"
    if sheet.bar_ends:
        sheets.draw_axis(pdf, x, y, half)
        first, second = sheet.bars[index // 2]
        words += f"  (bar {first}-{second})"
    sheets.draw_text(pdf, x, y + half + sheets.CUT_MARK_MM - 0.8, words, centred=True)


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
