"""What is printed is true to scale and is read again."""

import cv2
import numpy as np
import pytest

from omm_core.errors import InputError
from omm_core.targets import TargetFamily, detect_targets
from omm_core.targets.coded.printing import Sheet, parse_ids, ring_polygons, write_pdf

pytest.importorskip("fpdf", reason="fpdf2 is not installed")
DPI = 300.0


def _sheet(**options):
    family = TargetFamily.by_name("aicon14")
    return Sheet(**{"family": family, "ids": tuple(range(1, 10)), "dot_mm": 10.0, **options})


@pytest.mark.parametrize("white_on_black", [True, False])
def test_printed_targets_are_read_where_they_should_be(tmp_path, white_on_black):
    pdfium = pytest.importorskip("pypdfium2", reason="pypdfium2 is not installed")
    sheet = _sheet(white_on_black=white_on_black)
    assert write_pdf(sheet, tmp_path / "sheet.pdf") == 1
    page = pdfium.PdfDocument(tmp_path / "sheet.pdf")[0]
    picture = page.render(scale=DPI / 72.0).to_numpy()
    grey = cv2.cvtColor(np.ascontiguousarray(picture[:, :, :3]), cv2.COLOR_BGR2GRAY)
    found = {t.id: t for t in detect_targets(grey, sheet.family).targets}
    assert set(found) == set(sheet.ids)
    mm = 25.4 / DPI
    for target_id, _, x, y in sheet.places_mm():
        # The renderer stretches the page to whole pixels: up to 1 px at its far end.
        assert np.abs((found[target_id].center_px + 0.5) * mm - (x, y)).max() < 0.1
        assert found[target_id].diameter_px * mm == pytest.approx(10.0, abs=0.02)
        assert found[target_id].bright == white_on_black


def test_sheet_of_many_targets_has_several_pages(tmp_path):
    sheet = _sheet(ids=tuple(range(1, 61)))
    pages = write_pdf(sheet, tmp_path / "many.pdf")
    assert pages == sheet.places_mm()[-1][1] + 1 > 1


def test_neighbouring_sectors_are_one_outline():
    family = TargetFamily.by_name("metashape12")
    # 71 = 000001000111: one sector alone and three in a row.
    polygons = ring_polygons(family, 71, 4.0)
    assert len(polygons) == 2
    points = np.concatenate([np.array(p) for p in polygons])
    radii = np.hypot(*points.T)
    assert radii.min() == pytest.approx(9.0)
    assert radii.max() == pytest.approx(14.0)


@pytest.mark.parametrize(
    "options", [{"paper": "B4"}, {"dot_mm": -1.0}, {"ids": ()}, {"ids": (9999,)}, {"dot_mm": 200.0}]
)
def test_what_cannot_be_printed_is_refused(options):
    with pytest.raises(InputError):
        _sheet(**options)


def test_lists_of_numbers():
    assert parse_ids("1-3,7") == (1, 2, 3, 7)
    with pytest.raises(InputError, match="got 'x'"):
        parse_ids("1,x")
