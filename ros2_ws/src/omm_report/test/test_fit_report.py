"""What a fit is shown by: document, pictures, page."""

import io
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from omm_core.files.points import SurveyPoint, SurveyPoints
from omm_core.overstock import uncertainty
from omm_core.overstock.face import Face
from omm_core.overstock.fit import fit_part
from omm_core.overstock.fit_file import FitFile
from omm_core.overstock.what_if import what_if
from omm_report import fit_map
from omm_report.fit_map import map_of_faces, map_of_fit
from omm_report.fit_outputs import show_faces, write_pictures
from omm_report.fit_page import fit_page
from omm_report.fit_picture import faces_figure
from omm_report.fit_report import fit_document

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SIZE = np.array([300.0, 200.0, 100.0])
STOCK = (2.0, 4.0, 3.0, 3.0, 5.0, 1.0)


def block():
    faces = []
    for axis in range(3):
        for side, sign in enumerate((-1.0, 1.0)):
            square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
            corners = np.roll(np.insert(square, 0, side, axis=1), axis, axis=1) * SIZE
            order = [[0, 1, 2], [0, 2, 3]] if sign > 0 else [[0, 2, 1], [0, 3, 2]]
            faces.append(
                Face(
                    kind="plane",
                    triangles=corners[np.array(order)],
                    origin=corners[0],
                    axis=sign * np.eye(3)[axis],
                )
            )
    return tuple(faces)


@pytest.fixture(autouse=True)
def few_triangles(monkeypatch):
    monkeypatch.setattr(fit_map, "PIECES", 6.0)


@pytest.fixture(scope="module")
def given():
    random = np.random.default_rng(2)
    points = []
    for number, (face, stock) in enumerate(zip(block(), STOCK, strict=True)):
        for n in range(8):
            p = random.uniform(0.05, 0.95, 3) * SIZE
            p = p - ((p - face.origin) @ face.axis - stock) * face.axis
            name = "</script><b>" if (number, n) == (0, 0) else f"p{number}-{n}"
            points.append((name, None, p, face.axis))
    corners = [(0.0, 0.0, 103.0), (300.0, 0.0, 103.0), (300.0, 200.0, 103.0)]
    points += [(str(i), i, np.array(p), None) for i, p in enumerate(corners, start=1)]
    survey = SurveyPoints(
        target_family="aicon12",
        coded_dot_diameter_mm=8.0,
        points=tuple(
            SurveyPoint(name=n, id=i, xyz_mm=p, normal=v, covariance_mm2=1e-4 * np.eye(3))
            for n, i, p, v in points
        ),
    )
    file = FitFile(
        points=Path("points.json"),
        cad=Path("block.stl"),
        target_thickness_mm=0.0,
        minimum_overstock_mm=2.5,
        pairs={str(i): np.array(p) for i, p in enumerate(corners, start=1)},
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uncertainty, "DRAWS", 5)
        return fit_part(block(), file, survey), survey


def test_the_document_holds_the_result_and_is_the_same_twice(given):
    import pikepdf

    fit, survey = given
    other = what_if(fit, survey, {"1": -0.5})
    data = fit_document(fit, "fit.yaml", other)
    assert data == fit_document(fit, "fit.yaml", other)
    with pikepdf.open(io.BytesIO(data)) as document:
        inside = document.attachments["fit.json"].get_file().read_bytes()
    assert json.loads(inside) == fit.document


def test_the_map_tells_each_points_overstock_where_it_lies(given):
    drawn = map_of_fit(given[0])
    for number, stock in enumerate((3.0, 3.0, 3.0, 3.0, 3.0, 3.0)):
        assert drawn.values[drawn.face == number] == pytest.approx(stock, abs=1e-5)


def test_a_face_without_points_is_grey(given):
    drawn = map_of_faces(block())
    assert np.isnan(drawn.values).all()


def test_the_map_covers_the_part(given):
    drawn = map_of_fit(given[0])
    edges = drawn.corners[:, 1:] - drawn.corners[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()
    assert area == pytest.approx(2.0 * (300 * 200 + 300 * 100 + 200 * 100))


def test_the_page_needs_no_internet_and_no_name_ends_its_script(given):
    page = fit_page(given[0])
    assert not re.search(r"https?://|src=|@import|url\(", page)
    assert page.count("</script>") == 1
    assert "@CONTENT@" not in page
    content = re.search(r"const given = (\{.*?\});\n", page, re.DOTALL)
    assert content is not None
    labels = json.loads(content.group(1))["labels"]
    assert labels[0].startswith("</script><b>: 3.000 mm")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed (apt-get install chromium)")
def test_the_page_draws_in_a_browser(given, tmp_path):
    """The part's colours are on the canvas, and the script raises nothing."""
    from playwright.sync_api import sync_playwright

    path = tmp_path / "fit.html"
    path.write_text(fit_page(given[0]), encoding="utf-8")
    raised: list[str] = []
    with sync_playwright() as started:
        arguments = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        browser = started.chromium.launch(executable_path=CHROMIUM, args=arguments)
        page = browser.new_page()
        page.on("pageerror", lambda error: raised.append(str(error)))
        page.on("console", lambda message: raised.append(message.text))
        page.goto(path.as_uri())
        page.wait_for_function("document.querySelector('canvas').width > 300")
        picture = page.screenshot()
        browser.close()
    assert raised == []
    pixels = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), dtype=int)
    middle = pixels[200:400, 250:450]  # of the canvas; its ground is all but grey
    assert (np.ptp(middle, axis=2) > 30).mean() > 0.3


def test_pictures_are_written(given, tmp_path):
    fit, survey = given
    write_pictures(tmp_path / "new", fit, what_if(fit, survey, {"1": -0.5}))
    for name in ("overstock", "faces", "overstock_what_if"):
        with Image.open(tmp_path / "new" / f"{name}.png") as picture:
            assert picture.width > 800


def test_faces_that_are_seen_have_their_number():
    numbers = {text.get_text() for axes in faces_figure(map_of_faces(block())).axes
               for text in axes.texts}  # fmt: skip
    assert numbers == {"1", "2", "3", "4", "5", "6"}


def test_the_list_of_faces_is_drawn(tmp_path, capsys):
    import trimesh

    cad = tmp_path / "block.stl"
    cad.write_bytes(trimesh.creation.box(extents=SIZE).export(file_type="stl"))
    show_faces(cad, tmp_path, tmp_path)
    assert "plane (0 0 1) at 50.000" in capsys.readouterr().out
    assert (tmp_path / "block_faces.png").exists()
