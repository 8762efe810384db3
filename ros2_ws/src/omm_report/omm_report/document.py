"""Documents as PDF: the same content gives the same bytes, on any day.

Fonts are DejaVu, out of matplotlib's folder, and embedded: a document looks the same everywhere.
All dates inside are ``FIXED_DATE``: when something was measured is content, not a file's property.
It is PDF/A-3 where the installed fpdf2 can make that (2.8.5 and later).
"""

from __future__ import annotations

import inspect
import io
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

import matplotlib
import numpy as np
from fpdf import FPDF
from fpdf.fonts import FontFace
from numpy.typing import NDArray
from PIL import Image

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ARCHIVAL = "PDF/A-3B"
FIXED_DATE = datetime(2000, 1, 1, tzinfo=timezone.utc)
_FAMILY = "DejaVu"
_HEADING_PT = {1: 18, 2: 13, 3: 11}
_TEXT_PT = 9.5
_ALIGN = {"L": "LEFT", "R": "RIGHT", "C": "CENTER"}
_CAPTION_MM = 12.0
_BELOW_HEADING_MM = 15.0  # of what follows: a heading does not stand alone at the foot of a page


class Document:
    """An A4 document that grows from top to bottom.

    Parameters
    ----------
    title : str
        Stands on top, and in the file's properties.
    language : str
        Of the words in it.
    """

    def __init__(self, title: str, *, language: str = "en") -> None:
        self._pdf = FPDF(format="A4", unit="mm", **_compliance())
        if _compliance():
            self._pdf.set_xmp_metadata(_metadata(title, language))
        self._pdf.set_creation_date(FIXED_DATE)
        self._pdf.set_title(title)
        self._pdf.set_creator("omm")
        self._pdf.set_producer("omm")
        self._pdf.set_lang(language)
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        self._pdf.add_font(_FAMILY, "", fonts / "DejaVuSans.ttf")
        self._pdf.add_font(_FAMILY, "B", fonts / "DejaVuSans-Bold.ttf")
        letters = (set(font.cmap) for font in self._pdf.fonts.values())
        self._letters = set.intersection(*letters) | {ord("\n")}
        self._pdf.set_auto_page_break(True, margin=18)
        self._pdf.add_page()
        self._waiting: list[tuple[str, int]] = []
        self.heading(title, level=1)

    def heading(self, text: str, *, level: int = 2) -> None:
        """Add a heading; level 1 is the largest, 3 the smallest."""
        self._waiting.append((text, level))

    def _write_headings(self, below_mm: float = _BELOW_HEADING_MM) -> None:
        """Write the headings that wait for what they head, on the page that has room for both."""
        waiting, self._waiting = self._waiting, []
        lines_mm = sum(0.5 * _HEADING_PT[level] + 3.5 for _, level in waiting)
        if waiting and self._pdf.will_page_break(min(lines_mm + below_mm, self._pdf.eph)):
            self._pdf.add_page()
        for text, level in waiting:
            self._pdf.ln(2 if level > 1 else 0)
            self._pdf.set_font(_FAMILY, "B", _HEADING_PT[level])
            self._pdf.multi_cell(
                0, None, self._shown(text), new_x="LMARGIN", new_y="NEXT", align="L"
            )
            self._pdf.ln(1.5)

    def paragraph(self, text: str) -> None:
        """Add text; line breaks in it are kept."""
        self._write_headings()
        self._pdf.set_font(_FAMILY, "", _TEXT_PT)
        self._pdf.multi_cell(0, None, self._shown(text), new_x="LMARGIN", new_y="NEXT", align="L")
        self._pdf.ln(1.5)

    def table(
        self,
        rows: Sequence[Sequence[str]],
        *,
        widths: Sequence[float] | None = None,
        heading_row: bool = True,
        align: str = "",
    ) -> None:
        """Add a table; ``widths`` are the columns' shares of the page's width.

        The first row is repeated on each page where ``heading_row`` is true. ``align`` holds a
        letter for each column: L, R or C; without, all are on the left.
        """
        self._write_headings()
        self._pdf.set_font(_FAMILY, "", _TEXT_PT - 1)
        with self._pdf.table(
            col_widths=tuple(widths) if widths is not None else None,
            text_align=tuple(_ALIGN[letter] for letter in align) if align else "LEFT",
            line_height=1.35 * self._pdf.font_size,
            padding=(0.9, 1.5),
            first_row_as_headings=heading_row,
            headings_style=FontFace(emphasis="BOLD"),
            borders_layout="HORIZONTAL_LINES",
        ) as table:
            for cells in rows:
                row = table.row()
                for cell in cells:
                    row.cell(self._shown(cell))
        self._pdf.ln(2)

    def figure(self, figure: Figure, *, caption: str = "", width_mm: float = 170.0) -> None:
        """Add a matplotlib figure as a picture of 150 dpi."""
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
        with Image.open(buffer) as picture:
            self._picture(picture.convert("RGB"), caption, width_mm)

    def picture(
        self, pixels: NDArray[np.uint8], *, caption: str = "", width_mm: float = 170.0
    ) -> None:
        """Add an image: (rows, columns) grey or (rows, columns, 3) in the order R, G, B."""
        self._picture(Image.fromarray(np.ascontiguousarray(pixels)), caption, width_mm)

    def attach(self, name: str, content: bytes, *, description: str, mime_type: str) -> None:
        """Attach a file to the document, for programs to read."""
        self._pdf.embed_file(
            bytes=content,
            basename=name,
            desc=description,
            mime_type=mime_type,
            modification_date=FIXED_DATE,
            creation_date=FIXED_DATE,
        )

    def to_bytes(self) -> bytes:
        """Return the finished file; nothing can be added afterwards."""
        self._write_headings()
        return bytes(self._pdf.output())

    def _shown(self, text: str) -> str:
        """Return text with the number of each character that the fonts lack: ``<U+65E5>``.

        It would else be gone, two names would read the same, and PDF/A allows no empty glyph.
        """
        return "".join(c if ord(c) in self._letters else f"<U+{ord(c):04X}>" for c in text)

    def _picture(self, picture: Image.Image, caption: str, width_mm: float) -> None:
        width_mm = min(width_mm, self._pdf.epw)
        height_mm = width_mm * picture.height / picture.width
        below_mm = _CAPTION_MM if caption else 0.0
        largest_mm = self._pdf.eph - below_mm
        if height_mm > largest_mm:
            width_mm, height_mm = width_mm * largest_mm / height_mm, largest_mm
        self._write_headings(height_mm + below_mm)
        if self._pdf.will_page_break(height_mm + below_mm):
            self._pdf.add_page()
        self._pdf.image(picture, w=width_mm, h=height_mm, alt_text=caption or None)
        self._pdf.ln(1)
        if caption:
            self.paragraph(caption)


def _compliance() -> dict[str, str]:
    """Return what asks fpdf2 for PDF/A; nothing where it does not know it yet."""
    known = "enforce_compliance" in inspect.signature(FPDF.__init__).parameters
    return {"enforce_compliance": _ARCHIVAL} if known else {}


def _metadata(title: str, language: str) -> str:
    """Return the XMP that PDF/A wants; fpdf2's own would hold the time of day."""
    date = FIXED_DATE.strftime("%Y-%m-%dT%H:%M:%S+00:00")
    return f"""<x:xmpmeta xmlns:x="adobe:ns:meta/">
 <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
  <rdf:Description rdf:about="" xmlns:dc="http://purl.org/dc/elements/1.1/"
    xmlns:pdf="http://ns.adobe.com/pdf/1.3/" xmlns:pdfaid="http://www.aiim.org/pdfa/ns/id/"
    xmlns:xmp="http://ns.adobe.com/xap/1.0/" pdf:Producer="omm" xmp:CreatorTool="omm"
    xmp:CreateDate="{date}" xmp:ModifyDate="{date}" pdfaid:part="3" pdfaid:conformance="B">
   <dc:title><rdf:Alt><rdf:li xml:lang="x-default">{escape(title)}</rdf:li></rdf:Alt></dc:title>
   <dc:language><rdf:Bag><rdf:li>{escape(language)}</rdf:li></rdf:Bag></dc:language>
  </rdf:Description>
 </rdf:RDF>
</x:xmpmeta>"""
