"""Calibrations of COLMAP, ORB-SLAM, camodocal and people's JSON, and the ways to say a size."""

import json

import numpy as np
import pytest

from omm_core.camera_calibration.importing import foreign_pixels, import_lens
from omm_core.errors import InputError
from omm_core.files.foreign_calibration import read_foreign
from omm_core.imaging.calibration import load_calibration

WANTED = [2813.2, 2813.5, 1287.3, 999.1, -0.11, 0.09, 3e-4, -2e-4]
ROWS = [[2813.2, 0, 1287.3], [0, 2813.5, 999.1], [0, 0, 1]]
TERMS = [-0.11, 0.09, 3e-4, -2e-4, 0]
OPENCV = """%YAML:1.0
---
SIZE
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 2813.2, 0., 1287.3, 0., 2813.5, 999.1, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -1.1e-01, 9.0e-02, 3.0e-04, -2.0e-04, 0. ]
"""
ORB_SLAM = """%YAML:1.0
Camera.type: "PinHole"
Camera.fx: 2813.2
Camera.fy: 2813.5
Camera.cx: 1287.3
Camera.cy: 999.1
Camera.k1: -0.11
Camera.k2: 0.09
Camera.p1: 0.0003
Camera.p2: -0.0002
Camera.width: 2592
Camera.height: 1944
"""
CAMODOCAL = """%YAML:1.0
---
model_type: PINHOLE
image_width: 2592
image_height: 1944
distortion_parameters: {k1: -0.11, k2: 0.09, p1: 0.0003, p2: -0.0002}
projection_parameters: {fx: 2813.2, fy: 2813.5, cx: 1287.3, cy: 999.1}
"""
COLMAP = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
1 OPENCV 2592 1944 2813.2 2813.5 1287.8 999.6 -0.11 0.09 0.0003 -0.0002
"""


def read(tmp_path, text):
    path = tmp_path / "theirs"
    path.write_text(text)
    return read_foreign(path)


def lens_numbers(tmp_path, text) -> list[float]:
    result = import_lens(read(tmp_path, text))
    assert result.largest_error_px == 0.0
    lens = result.lens
    assert (lens.width_px, lens.height_px) == (2592, 1944)
    return [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, lens.k1, lens.k2, lens.p1, lens.p2]


@pytest.mark.parametrize(
    "size",
    [
        "image_size: [ 2592, 1944 ]",
        "imageSize: {width: 2592, height: 1944}",
        "img_width: 2592\nimg_height: 1944",
        "image_Width: 2592\nimage_Height: 1944",
        "image_size: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: i\n   data: [ 2592, 1944 ]",
    ],
)
def test_opencv_files_say_the_images_size_in_many_ways(tmp_path, size):
    assert lens_numbers(tmp_path, OPENCV.replace("SIZE", size)) == pytest.approx(WANTED)


@pytest.mark.parametrize("text", [ORB_SLAM, CAMODOCAL, COLMAP])
def test_files_that_name_their_numbers_are_read(tmp_path, text):
    assert lens_numbers(tmp_path, text) == pytest.approx(WANTED, rel=1e-12)


@pytest.mark.parametrize(
    "dumped",
    [
        {"camera_matrix": ROWS, "dist_coeff": [TERMS], "image_size": [2592, 1944]},
        {"mtx": ROWS, "dist": [TERMS], "width": 2592, "height": 1944},
        {"K": ROWS, "D": TERMS, "img_size": [2592, 1944]},
        {
            "cameraMatrix": [*ROWS[0], *ROWS[1], *ROWS[2]],
            "distCoeffs": TERMS,
            "imageSize": [2592, 1944],
        },
    ],
)
@pytest.mark.parametrize("indent", [None, 2])
def test_what_people_dump_as_json_is_read(tmp_path, dumped, indent):
    text = json.dumps(dumped, indent=indent)
    assert lens_numbers(tmp_path, text) == pytest.approx(WANTED)
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match="a calibration of OpenCV"):
        load_calibration(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (COLMAP.replace("OPENCV", "THIN_PRISM_FISHEYE"), "expected a camera model of"),
        (COLMAP.replace(" -0.0002", ""), "expected 8 numbers"),
        (CAMODOCAL.replace("PINHOLE", "MEI"), "'MEI'"),
        (ORB_SLAM.replace("PinHole", "Rectified"), "'Rectified'"),
        (ORB_SLAM.replace("2813.2", "2813,2"), "write 2813.2"),
        (OPENCV.replace("SIZE", "image_size: [ 2592 ]"), "width and height"),
        (OPENCV.replace("SIZE", ""), "Add it to the file"),
    ],
)
def test_what_they_do_not_tell_is_asked_for_by_name(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)


def test_of_two_cameras_the_first_is_taken_and_told(tmp_path):
    found = read(tmp_path, COLMAP + "2 PINHOLE 640 480 500 500 320 240\n").findings
    assert found == ("camera 1 is taken, not 2",)


def test_a_fisheye_of_colmap_is_opencvs(tmp_path):
    cv2 = pytest.importorskip("cv2")
    text = COLMAP.replace("OPENCV", "OPENCV_FISHEYE").replace(" 0.0003 -0.0002", " 0.001 -0.002")
    foreign = read(tmp_path, text)
    rays = np.random.default_rng(0).uniform(-0.4, 0.4, (20, 2))
    theirs = cv2.fisheye.distortPoints(
        rays[:, None], foreign.matrix, np.array([-0.11, 0.09, 0.001, -0.002])
    )
    assert foreign_pixels(foreign, rays) == pytest.approx(theirs.reshape(-1, 2), abs=1e-9)


def test_metashapes_tangential_terms_grow_with_the_radius(tmp_path):
    text = """<calibration><width>2592</width><height>1944</height><f>2813.2</f><cx>-8.7</cx>
    <p1>0.0003</p1><p2>-0.0002</p2><p3>0.5</p3><p4>-0.7</p4></calibration>"""
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    more = 1 + 0.5 * r2 - 0.7 * r2**2
    col = x + more * (3e-4 * (r2 + 2 * x * x) + 2 * -2e-4 * x * y)
    row = y + more * (-2e-4 * (r2 + 2 * y * y) + 2 * 3e-4 * x * y)
    expected = (1286.8 + 2813.2 * col, 971.5 + 2813.2 * row)
    seen = foreign_pixels(read(tmp_path, text), np.array([[x, y]]))[0]
    assert seen == pytest.approx(expected, abs=1e-9)


def test_a_size_whose_middle_is_elsewhere_is_told(tmp_path):
    text = OPENCV.replace("SIZE", "image_size: [1944, 2592]")
    assert any("width first" in words for words in read(tmp_path, text).findings)
