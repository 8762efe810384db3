"""Part and calibration files: what is read, and what is said about a bad one."""

import copy
import os

import numpy as np
import pytest
import yaml

from omm_core.errors import InputError
from omm_core.files.part import load_part
from omm_core.geometry import rotation_from_euler_xyz_rad
from omm_core.imaging.calibration import load_calibration
from omm_core.imaging.lens import BrownPhotogrammetric, PlumbBob

CAMERA = {
    "camera": {"name": "c", "width_px": 2592, "height_px": 1944, "pixel_size_mm": 0.0022},
    "model": "brown_photogrammetric",
    "intrinsics": {
        "focal_length_mm": 6.189, "principal_point_offset_px": [-8.732, 27.52],
        "k1_px2": 2.997e-08, "k2_px4": -1.937e-15, "p1_px": -6.188e-08, "p2_px": 3.408e-07,
    },
    "taper_to_camera": {
        "translation_mm": [-2.139, 0.301, -320.2], "euler_xyz_rad": [3.1386, -0.009, 0.03],
    },
}  # fmt: skip
PART = {
    "part": {"name": "p"},
    "target_family": "metashape12",
    "targets": [
        {"id": 42, "xyz_mm": [0.0, 0.0, 3.0], "dot_diameter_mm": 8.0},
        {"id": 40, "xyz_mm": [1500, 0, 11], "dot_diameter_mm": 8, "normal": [0, 0, 2.0]},
        {"id": 8, "xyz_mm": [1500, 1000, 8], "dot_diameter_mm": 8, "sigma_xyz_mm": 0.02},
        {"id": 122, "xyz_mm": [0, 1000, 3], "dot_diameter_mm": 8, "sigma_xyz_mm": [1, 2, 3]},
    ],
}


def changed(document, path, value):
    """Return a copy in which the value at a path of keys is another, or gone (None)."""
    document = copy.deepcopy(document)
    place = document
    for key in path[:-1]:
        place = place[key]
    if value is None:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return document


def written(tmp_path, document):
    path = tmp_path / "file.yaml"
    path.write_text(document if isinstance(document, str) else yaml.safe_dump(document))
    return path


def test_brown_calibration_is_read(tmp_path):
    calibration = load_calibration(written(tmp_path, CAMERA))
    assert isinstance(calibration.lens, BrownPhotogrammetric)
    assert (calibration.width_px, calibration.height_px) == (2592, 1944)
    assert calibration.lens.p2_px == 3.408e-07
    assert np.allclose(
        calibration.taper_T_camera.rotation, rotation_from_euler_xyz_rad(3.1386, -0.009, 0.03)
    )
    assert calibration.parameters == ()


def test_plumb_bob_calibration_is_read(tmp_path):
    document = changed(CAMERA, ["model"], "plumb_bob")
    document["intrinsics"] = {
        "fx_px": 2800, "fy_px": 2801, "cx_px": 1290, "cy_px": 970,
        "k1": -0.2, "k2": 0.1, "p1": 0, "p2": 0.001,
    }  # fmt: skip
    lens = load_calibration(written(tmp_path, document)).lens
    assert isinstance(lens, PlumbBob)
    assert (lens.fy_px, lens.p2, lens.k3) == (2801.0, 0.001, 0.0)


@pytest.mark.parametrize("nested", [True, False])
def test_calibration_covariance_keeps_its_order(tmp_path, nested):
    names, matrix = ["z_mm", "focal_length_mm"], [[4e-4, 1e-4], [1e-4, 1e-4]]
    covariance = {"parameters": names, "matrix": matrix} if nested else matrix
    document = {**CAMERA, "covariance": covariance} | ({} if nested else {"parameters": names})
    calibration = load_calibration(written(tmp_path, document))
    assert calibration.parameters == ("z_mm", "focal_length_mm")
    assert np.array_equal(calibration.covariance, matrix)


def test_parameters_are_a_vector_that_can_be_changed(tmp_path):
    calibration = load_calibration(written(tmp_path, CAMERA))
    names = calibration.parameter_names()
    values = calibration.parameter_values(names)
    assert values[names.index("focal_length_mm")] == 6.189
    moved = calibration.with_parameters(("z_mm", "k1_px2"), [-321.0, 3e-8])
    expected = values.copy()
    expected[names.index("z_mm")], expected[names.index("k1_px2")] = -321.0, 3e-8
    assert np.allclose(moved.parameter_values(names), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["model"], "fisheye", "fisheye"),
        (["model"], None, "'model' is missing"),
        (["camera", "width_px"], None, "'width_px' is missing"),
        (["camera", "width_px"], 0, "whole number"),
        (["camera", "width_px"], 2592.5, "whole number"),
        (["camera"], "DMK", "expected keys"),
        (["intrinsics", "focal_length_mm"], -6.0, "above 0"),
        (["intrinsics", "focal_length_mm"], "six", "number above 0"),
        (["intrinsics", "k1_px2"], float("nan"), "finite number"),
        (["intrinsics", "k1_px2"], -3e-6, "folds back"),
        (["intrinsics", "principal_point_offset_px"], [1.0], "2 numbers"),
        (["taper_to_camera", "euler_xyz_rad"], [0.0, "a", 0.0], "finite number"),
        (["taper_to_camera"], None, "'taper_to_camera' is missing"),
        (["covariance"], {"parameters": ["f"], "matrix": [[1.0]]}, "focal_length_mm"),
        (["covariance"], {"parameters": ["z_mm"], "matrix": [[-1.0]]}, "negative variance"),
        (["covariance"], {"parameters": ["z_mm", "x_mm"], "matrix": [[1.0]]}, "one row"),
    ],
)
def test_bad_calibration_is_told(tmp_path, path, value, message):
    with pytest.raises(InputError, match=message) as told:
        load_calibration(written(tmp_path, changed(CAMERA, path, value)))
    assert "file.yaml" in str(told.value)


def test_image_of_another_sensor_is_refused(tmp_path):
    calibration = load_calibration(written(tmp_path, CAMERA))
    calibration.check_image_shape((1944, 2592))
    with pytest.raises(InputError, match=r"2592 x 1944.*640 x 480"):
        calibration.check_image_shape((480, 640))


def test_part_is_read(tmp_path):
    part = load_part(written(tmp_path, PART))
    assert (part.name, part.target_family) == ("p", "metashape12")
    assert [target.id for target in part.targets] == [42, 40, 8, 122]
    assert np.array_equal(part.targets[1].normal, [0, 0, 1])
    assert np.array_equal(part.target(8).sigma_xyz_mm, [0.02] * 3)
    assert np.array_equal(part.target(122).sigma_xyz_mm, [1, 2, 3])
    assert part.target(1) is None


def test_a_missing_normal_is_that_of_the_plane_through_the_targets(tmp_path):
    part = load_part(written(tmp_path, PART))
    expected = np.array([-8.0 / 1500 * 0.8, 0.0, 1.0])
    assert abs(part.normal_of(part.targets[0]) @ expected) == pytest.approx(1.0, abs=1e-4)
    assert np.array_equal(part.normal_of(part.targets[1]), [0, 0, 1])


def test_targets_on_a_line_span_no_plane(tmp_path):
    document = changed(PART, ["targets"], PART["targets"][:2])
    assert load_part(written(tmp_path, document)).plane_normal() is None


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["target_family"], "aruco", "aruco"),
        (["targets"], [], "at least one"),
        (["targets", 1, "id"], 42, "42 more than once"),
        (["targets", 1, "id"], "forty", "whole number"),
        (["targets", 1, "xyz_mm"], None, r"entry 2 \(id 40\).*'xyz_mm' is missing"),
        (["targets", 1, "xyz_mm"], [1.0, 2.0], "3 numbers"),
        (["targets", 1, "dot_diameter_mm"], 0.0, "above 0"),
        (["targets", 1, "normal"], [0, 0, 0], "direction"),
        (["targets", 2, "sigma_xyz_mm"], -0.1, ">= 0"),
        (["part"], None, "'part' is missing"),
    ],
)
def test_bad_part_is_told(tmp_path, path, value, message):
    with pytest.raises(InputError, match=message):
        load_part(written(tmp_path, changed(PART, path, value)))


@pytest.mark.parametrize("load", [load_part, load_calibration])
def test_files_that_are_no_yaml_are_told(tmp_path, load):
    with pytest.raises(InputError, match="no such file"):
        load(tmp_path / "absent.yaml")
    with pytest.raises(InputError, match="is not YAML"):
        load(written(tmp_path, "a: [1, 2"))
    with pytest.raises(InputError, match="expected keys"):
        load(written(tmp_path, "just words"))
    (tmp_path / "file.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match=r"cannot be read|not YAML"):
        load(tmp_path / "file.yaml")


def test_a_key_that_stands_twice_is_refused_with_both_lines(tmp_path):
    file = tmp_path / "part.yaml"
    file.write_text(
        "part: {name: plate}\ntargets:\n- id: 1\n  xyz_mm: [0, 0, 0]\n  xyz_mm: [0, 0, 5]\n"
    )
    with pytest.raises(InputError, match=r"'xyz_mm' stands twice, in lines 4 and 5"):
        load_part(file)


@pytest.mark.parametrize(
    "text",
    ["[" * 5000, "a: " + "9" * 5000, "a: &a [1, 1]\nb: &b [*a, *a]\npart: [*b, *b]\n"],
    ids=["nested", "digits", "aliases"],
)
def test_a_file_made_to_overwhelm_is_refused_in_few_words(tmp_path, text):
    file = tmp_path / "part.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as refused:
        load_part(file)
    assert len(str(refused.value)) < 600


def test_what_is_no_ordinary_file_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "part.yaml")
    with pytest.raises(InputError, match="not an ordinary file"):
        load_part(tmp_path / "part.yaml")
