"""Calibrations of other programs are recognised by what they are, and their lens is taken."""

import numpy as np
import pytest

from omm_core.camera_calibration.importing import foreign_pixels, import_lens
from omm_core.errors import InputError
from omm_core.files.foreign_calibration import foreign_source, read_foreign
from omm_core.imaging.calibration import load_calibration

NUMBERS = "[2813.2, 0., 1287.3, 0., 2813.5, 999.1, 0., 0., 1.]"
ROS = f"""image_width: 2592
image_height: 1944
camera_name: mill
camera_matrix: {{rows: 3, cols: 3, data: {NUMBERS}}}
distortion_model: MODEL
distortion_coefficients: {{rows: 1, cols: 5, data: DATA}}
"""
PLUMB_BOB = ROS.replace("MODEL", "plumb_bob").replace("DATA", "[-0.11, 0.09, 3e-4, -2e-4, 0.01]")
OPENCV = f"""%YAML:1.0
---
image_width: 2592
image_height: 1944
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: {NUMBERS}
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -1.1e-01, 9.0e-02, 3.0e-04, -2.0e-04, 1.0e-02 ]
"""
OPENCV_XML = """<?xml version="1.0"?><opencv_storage>
<image_width>2592</image_width><image_height>1944</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>
 2813.2 0. 1287.3 0. 2813.5 999.1 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt><data>
 -0.11 0.09 3e-4 -2e-4 0.01</data></distortion_coefficients></opencv_storage>
"""
KALIBR = """cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.11, 0.09, 0.0003, -0.0002]
  distortion_model: radtan
  intrinsics: [2813.2, 2813.5, 1287.3, 999.1]
  resolution: [2592, 1944]
"""
METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<calibration><projection>frame</projection><width>2592</width><height>1944</height>
<f>2813.2</f><cx>-8.7</cx><cy>27.5</cy><b1>0.3</b1><k1>-0.11</k1><k2>0.09</k2><k3>0.01</k3>
<p1>0.0003</p1><p2>-0.0002</p2></calibration>
"""
INI = """# oST version 5.0 parameters

[image]

width
2592

height
1944

[mill]

camera matrix
2813.2 0.0 1287.3
0.0 2813.5 999.1
0.0 0.0 1.0

distortion
-0.11 0.09 0.0003 -0.0002 0.01
"""


def imported(tmp_path, text):
    path = tmp_path / "theirs"
    path.write_text(text)
    return import_lens(read_foreign(path))


@pytest.mark.parametrize(
    ("text", "k3"),
    [(PLUMB_BOB, 0.01), (OPENCV, 0.01), (OPENCV_XML, 0.01), (INI, 0.01), (KALIBR, 0)],
)
def test_the_same_model_keeps_its_numbers(tmp_path, text, k3):
    result = imported(tmp_path, text)
    expected = [2813.2, 2813.5, 1287.3, 999.1, -0.11, 0.09, 3e-4, -2e-4, k3]
    lens = result.lens
    got = [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px]
    got += [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]
    assert got == pytest.approx(expected, rel=1e-12)
    assert result.largest_error_px == 0.0


def test_metashape_begins_at_the_corner_and_swaps_the_tangential_terms(tmp_path):
    lens = imported(tmp_path, METASHAPE).lens
    # Its manual: u = w/2 + cx + x' f + x' b1 with the first pixel's centre at 0.5.
    assert (lens.cx_px, lens.cy_px) == pytest.approx((1296 - 0.5 - 8.7, 972 - 0.5 + 27.5))
    assert (lens.fx_px, lens.fy_px) == pytest.approx((2813.5, 2813.2))
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    scale = 1 - 0.11 * r2 + 0.09 * r2**2 + 0.01 * r2**3
    col = x * scale + 3e-4 * (r2 + 2 * x * x) + 2 * -2e-4 * x * y
    row = y * scale + -2e-4 * (r2 + 2 * y * y) + 2 * 3e-4 * x * y
    expected = (1286.8 + 2813.5 * col, 999.0 + 2813.2 * row)
    assert lens.project([[x, y, 1.0]])[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("model", "data"),
    [
        ("equidistant", "[0.1, -0.02, 0.003, 0.0]"),
        ("rational_polynomial", "[-0.11, 0.09, 3e-4, -2e-4, 0.0, 0.01, -0.02, 0.003]"),
        ("rational_polynomial", "[-0.3, 0.4, 3e-4, -2e-4, 0.1, 0.2, 0.3, 0.4]"),
    ],
)
def test_the_error_told_of_another_model_bounds_what_is_seen(tmp_path, model, data):
    path = tmp_path / "ost.yaml"
    path.write_text(ROS.replace("MODEL", model).replace("DATA", data))
    foreign = read_foreign(path)
    result = import_lens(foreign)
    pixels = result.lens.pixel_grid(23)
    rays = result.lens.normalised_from_pixels(pixels)
    left = np.hypot(*(foreign_pixels(foreign, rays) - pixels).T).max()
    assert 0.0 < left <= 1.1 * result.largest_error_px
    assert any("the lens model is another" in words for words in result.findings)


def test_opencv_agrees_about_the_rational_lens(tmp_path):
    cv2 = pytest.importorskip("cv2")
    coefficients = [-0.3, 0.4, 3e-4, -2e-4, 0.1, 0.2, 0.3, 0.4, 1e-3, -2e-3, 3e-3, 4e-3]
    path = tmp_path / "ost.yaml"
    path.write_text(ROS.replace("MODEL", "rational_polynomial").replace("DATA", str(coefficients)))
    foreign = read_foreign(path)
    rays = np.random.default_rng(0).uniform(-0.4, 0.4, (50, 2))
    points = np.column_stack([rays, np.ones(50)])
    zero = np.zeros(3)
    theirs = cv2.projectPoints(points, zero, zero, foreign.matrix, np.array(coefficients))[0]
    assert foreign_pixels(foreign, rays) == pytest.approx(theirs.reshape(-1, 2), abs=1e-9)


@pytest.mark.parametrize(
    ("text", "source"),
    [
        (PLUMB_BOB, "ROS"), (INI, "ROS"), (OPENCV, "OpenCV"), (OPENCV_XML, "OpenCV"),
        (KALIBR, "Kalibr"), (METASHAPE, "Metashape"),
    ],
)  # fmt: skip
def test_given_as_camera_file_they_are_named_with_the_way_out(tmp_path, text, source):
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"a calibration of {source}.*taper_to_camera.*--import"):
        load_calibration(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("image_width: 2592\n", "", "Add it to the file as 'image_width"),
        ("2592", "2592.5", "whole pixels"),
        ("1287.3", "2700.0", "width first"),
        ("2813.2, 0.", "2813,2, 0.", "decimal commas"),
        ("image_height: 1944", "image_height: 1944,5", "decimal point"),
        ("2813.2", ".Nan", "finite"),
        ("plumb_bob", "omnidirectional", "omnidirectional"),
        ("0.01]", "0.01, 0]", "expected 0, 4, 5, 8, 12 or 14 coefficients, got 6"),
        ("2813.2", ".nan", "finite"),
        ("2813.2", "0.0", "above zero"),
        ("-0.11", "-90.0", "folds back"),
    ],
)
def test_what_cannot_be_a_lens_is_refused_in_words(tmp_path, old, new, words):
    with pytest.raises(InputError, match=words):
        imported(tmp_path, PLUMB_BOB.replace(old, new))


CAMERA_INFO = """height: 1944
width: 2592
distortion_model: plumb_bob
d: [-0.11, 0.09, 0.0003, -0.0002, 0.01]
k: [2813.2, 0.0, 1287.3, 0.0, 2813.5, 999.1, 0.0, 0.0, 1.0]
binning_x: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
---
"""
OF_FOUR = OPENCV.replace("rows: 5", "rows: 4").replace(", 1.0e-02 ]", " ]")
SEVERAL = """<document><chunk><sensors><sensor><calibration type="frame">
<resolution width="2592" height="1944"/><f>2813.2</f></calibration></sensor></sensors></chunk>
</document>"""


def test_a_camera_info_as_ros2_topic_echo_prints_it_is_taken(tmp_path):
    lens = imported(tmp_path, CAMERA_INFO + CAMERA_INFO).lens
    assert (lens.fx_px, lens.cy_px, lens.k3) == (2813.2, 999.1, 0.01)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (OPENCV + "xi: 1.2\n", "omnidirectional"),
        (OPENCV_XML.replace("</opencv_storage>", "<xi>1.2</xi></opencv_storage>"), "omnidir"),
        (OF_FOUR, "fisheye has 4 coefficients"),
        (INI.replace(" 0.01\n", "\n"), "fisheye has 4 coefficients"),
        (PLUMB_BOB.replace("plumb_bob", "equidistant"), "expected 4 coefficients"),
        (KALIBR.replace("radtan", "fov"), "expected 1 coefficients"),
        (KALIBR.replace("  distortion_model: radtan\n", ""), "distortion_model' is missing"),
        (KALIBR.replace("pinhole", "omni"), "'omni'"),
        (CAMERA_INFO.replace("binning_x: 0", "binning_x: 2"), "binning"),
        (CAMERA_INFO.replace("height: 0, width: 0", "height: 500, width: 500"), "roi"),
        (METASHAPE.replace(">frame<", ">fisheye<"), "'fisheye'"),
        (METASHAPE.replace("<width>2592</width>", ""), "'width' is missing"),
        (METASHAPE.replace("<f>", "<fx>").replace("</f>", "</fx>"), "save it again"),
        (SEVERAL, "a document of cameras"),
    ],
)
def test_a_lens_that_the_numbers_do_not_tell_is_refused_by_name(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        imported(tmp_path, text)


@pytest.mark.parametrize("name", ["fisheye_model: 0", "distortion_model: plumb_bob"])
def test_four_coefficients_whose_model_is_told_are_taken(tmp_path, name):
    assert imported(tmp_path, f"{OF_FOUR}{name}\n").lens.k1 == -0.11


OURS = """camera: {name: a, width_px: 2592, height_px: 1944}
model: plumb_bob
intrinsics: {fx_px: 2813.2, fy_px: 2813.5, cx_px: 1287.3, cy_px: 999.1, k1: -0.1, k2: 0.1, p1: 0,
  p2: 0, MORE}
taper_to_camera: {translation_mm: [0, 0, -200], euler_xyz_rad: [3.14, 0, 0]}
"""


@pytest.mark.parametrize("term", ["k4: 0.01", "k6: 1.0e-3", "s1: 1.0e-4", "xi: 1.2"])
def test_a_camera_file_with_a_term_of_another_model_is_refused_by_the_term(tmp_path, term):
    """Read without it, the lens would be another; a term that is 0 changes nothing."""
    path = tmp_path / "camera.yaml"
    path.write_text(OURS.replace("MORE", term))
    with pytest.raises(InputError, match=f"got {term.split(':')[0]}: "):
        load_calibration(path)
    path.write_text(OURS.replace("MORE", f"{term.split(':')[0]}: 0.0"))
    load_calibration(path)


def test_a_camera_file_of_ones_own_is_nobody_elses():
    assert foreign_source("camera: {name: a}\nmodel: plumb_bob\nintrinsics: {fx_px: 1}\n") is None
