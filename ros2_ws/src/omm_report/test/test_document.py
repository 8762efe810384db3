"""Documents: the same content gives the same bytes; what was put in can be read out."""

import io
import time

import numpy as np
import pikepdf

from omm_report import document as document_module
from omm_report.document import Document


def _document(value: str = "1.25") -> bytes:
    from matplotlib.figure import Figure

    document = Document("Part β, α and γ")
    document.heading("Result")
    document.paragraph("Größe ± 0,01 mm\nsecond line")
    document.table([["quantity", "value"], ["α", value]], widths=(1, 2))
    figure = Figure(figsize=(4, 2))
    figure.subplots().plot([0, 1], [1, 0])
    document.figure(figure, caption="A line")
    document.picture(np.full((20, 30), 128, dtype=np.uint8))
    document.attach("data.json", b'{"a": 1}', description="data", mime_type="application/json")
    return document.to_bytes()


def test_same_content_same_bytes_in_another_second() -> None:
    first = _document()
    time.sleep(1.1)
    assert _document() == first


def test_other_content_gives_other_bytes() -> None:
    assert _document("1.26") != _document()


def test_attachment_comes_out_as_it_went_in() -> None:
    with pikepdf.open(io.BytesIO(_document())) as pdf:
        assert pdf.attachments["data.json"].get_file().read_bytes() == b'{"a": 1}'


def test_every_font_is_embedded() -> None:
    with pikepdf.open(io.BytesIO(_document())) as pdf:
        fonts = [o for o in pdf.objects if isinstance(o, pikepdf.Dictionary)]
        described = [o for o in fonts if o.get("/Type") == "/FontDescriptor"]
    assert len(described) == 2
    assert all("/FontFile2" in o for o in described)
    assert document_module.FIXED_DATE.year == 2000


def test_letters_that_the_fonts_lack_stand_there_by_their_number(caplog) -> None:  # type: ignore[no-untyped-def]
    """A glyph that is not there is not allowed in PDF/A, and two names would read the same."""

    def named(name: str) -> bytes:
        document = Document(f"Teil {name}")
        document.table([[f"größe {name}", "1"]])
        return document.to_bytes()

    assert named("日") != named("本")
    assert "missing" not in caplog.text


def test_a_heading_stands_on_the_page_of_what_it_heads() -> None:
    from matplotlib.figure import Figure

    document = Document("Title")
    document.picture(np.zeros((120, 100), dtype=np.uint8))
    document.heading("Further down")
    document.figure(Figure(figsize=(4, 3)))
    with pikepdf.open(io.BytesIO(document.to_bytes())) as pdf:
        drawn = [page.Contents.read_bytes() for page in pdf.pages]
    assert [page.count(b" Tj") + page.count(b" TJ") for page in drawn] == [1, 1]
