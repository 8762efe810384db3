"""What is printed is true to scale and is read again."""

import cv2
import numpy as np
import pytest

from omm_core.errors import InputError
from omm_core.targets import TargetFamily, detect_targets
from omm_core.targets.coded.printing import Sheet, parse_ids, ring_polygons, write_pdf
from omm_core.targets.plain import PlainOptions, find_plain_dots
from omm_core.targets.plain.printing import PlainSheet
from omm_core.targets.plain.printing import write_pdf as write_plain_pdf

pytest.importorskip("fpdf", reason="fpdf2 is not installed")
DPI = 300.0


def _sheet(**options):
    family = TargetFamily.by_name("aicon14")
    return Sheet(**{"family": family, "ids": tuple(range(1, 10)), "dot_mm": 10.0, **options})


@pytest.mark.parametrize("white_on_black", [True, False])
def test_printed_targets_are_read_where_they_should_be(tmp_path, white_on_black):
    sheet = _sheet(white_on_black=white_on_black)
    assert write_pdf(sheet, tmp_path / "sheet.pdf") == 1
    grey = _scanned(tmp_path / "sheet.pdf")
    found = {t.id: t for t in detect_targets(grey, sheet.family).targets}
    assert set(found) == set(sheet.ids)
    mm = 25.4 / DPI
    for target_id, _, x, y in sheet.places_mm():
        # The renderer stretches the page to whole pixels: up to 1 px at its far end.
        assert np.abs((found[target_id].center_px + 0.5) * mm - (x, y)).max() < 0.1
        assert found[target_id].diameter_px * mm == pytest.approx(10.0, abs=0.02)
        assert found[target_id].bright == white_on_black


@pytest.mark.parametrize("white_on_black", [True, False])
def test_printed_plain_targets_are_found_where_they_should_be_and_no_others(
    tmp_path, white_on_black
):
    sheet = PlainSheet(count=40, dot_mm=6.0, white_on_black=white_on_black)
    assert write_plain_pdf(sheet, tmp_path / "plain.pdf") == 1
    # As a photograph shows it: ink is not black, paper does not saturate, edges are not sharp.
    seen = 30.0 + 0.7 * cv2.GaussianBlur(_scanned(tmp_path / "plain.pdf"), (0, 0), 0.8)
    dots = find_plain_dots(seen.astype(np.uint8), PlainOptions(bright=white_on_black))
    mm = 25.4 / DPI
    there = np.array([(d.center_px + 0.5) * mm for d in dots])
    wanted = np.array([(x, y) for _, x, y in sheet.places_mm()])
    apart = np.linalg.norm(wanted[:, None] - there[None], axis=2)
    assert apart.min(axis=1).max() < 0.1
    assert len(dots) == 40


def test_plain_targets_that_do_not_fit_go_on_to_the_next_page(tmp_path):
    sheet = PlainSheet(count=90, dot_mm=6.0)
    assert write_plain_pdf(sheet, tmp_path / "plain.pdf") == 2
    places = sheet.places_mm()
    assert len(set(places)) == 90
    per_page = sum(page == 0 for page, _, _ in places)
    first, second = ([p[1:] for p in places if p[0] == page] for page in (0, 1))
    assert second == first[: 90 - per_page]


def test_ends_of_scale_bars_are_read_and_go_in_pairs(tmp_path):
    sheet = _sheet(ids=(1, 2, 3, 5), bar_ends=True)
    assert sheet.bars == ((1, 2), (3, 5))
    write_pdf(sheet, tmp_path / "bars.pdf")
    plain = _sheet(ids=(1, 2, 3, 5))
    write_pdf(plain, tmp_path / "without.pdf")
    grey, without = _scanned(tmp_path / "bars.pdf"), _scanned(tmp_path / "without.pdf")
    assert {t.id for t in detect_targets(grey, sheet.family).targets} == {1, 2, 3, 5}
    # The axis goes through the dot's centre, outside of the square that is cut out.
    _, _, x, y = sheet.places_mm()[0]
    row = round(y * DPI / 25.4)
    beside = slice(
        round((x + 0.5 * sheet.square_mm + 1.0) * DPI / 25.4),
        round((x + 0.5 * sheet.square_mm + 2.5) * DPI / 25.4),
    )
    assert grey[row - 3 : row + 4, beside].min(axis=0).max() < 200
    assert without[row - 3 : row + 4, beside].min() == 255


def _scanned(path):
    pdfium = pytest.importorskip("pypdfium2", reason="pypdfium2 is not installed")
    picture = pdfium.PdfDocument(path)[0].render(scale=DPI / 72.0).to_numpy()
    return cv2.cvtColor(np.ascontiguousarray(picture[:, :, :3]), cv2.COLOR_BGR2GRAY)


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
    "options", [{"paper": "B4"}, {"dot_mm": -1.0}, {"count": 0}, {"count": -3}, {"dot_mm": 200.0}]
)
def test_plain_targets_that_cannot_be_printed_are_refused(options):
    with pytest.raises(InputError):
        PlainSheet(**{"count": 4, "dot_mm": 6.0, **options})


def test_a_scale_bar_has_two_ends():
    with pytest.raises(InputError, match="got 3"):
        _sheet(ids=(1, 2, 3), bar_ends=True)


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
