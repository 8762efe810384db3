"""machine.yaml and URDF as machines; part.yaml's and camera.yaml's optional keys."""

import dataclasses

import numpy as np
import pytest
import yaml

from omm_core.errors import InputError
from omm_core.files.machine import AxisDynamics, Follows, MachineUncertainty, Timing, load_machine
from omm_core.files.outside import Text
from omm_core.files.part import load_part, part_yaml
from omm_core.imaging.calibration import load_calibration

MACHINE = """
machine: {name: mill 1, urdf: mill.urdf, up: [0, 0, 2]}
uncertainty: {stop_sigma_mm: 0.003, geometry_sigma_mm: null, geometry_length_mm: null}
axes:
  X: {velocity_mm_per_s: 1000, acceleration_mm_per_s2: 3000, jerk_mm_per_s3: 30000}
  Y2: {follows: Y, tolerance_mm: 0.02}
  B: {velocity_rad_per_s: 1}
  W: {ignored: true}
timing: {settling_s: 0.3, image_s: 0.5}
"""
PART = {
    "part": {"name": "p"},
    "target_family": "metashape12",
    "targets": [
        {"id": 42, "xyz_mm": [0, 0, 3], "dot_diameter_mm": 8},
        {"id": 40, "xyz_mm": [1500, 0, 11], "dot_diameter_mm": 8, "sigma_xyz_mm": 0},
        {"id": 8, "xyz_mm": [1500, 1000, -8], "dot_diameter_mm": 8, "sigma_xyz_mm": [1, 2, 3]},
    ],
}
WISHES = {
    "box_mm": [[0, 0, 0], [1500, 1000, 500]],
    "nominal": {"translation_mm": [100, None, 50], "euler_xyz_rad": None},
    "tolerances": {"z_mm": 1, "alpha_rad": 5.0e-5},
    "jacks": [{"name": "J1", "xyz_mm": [-400, -100, 0], "travel_mm": [-20, 20]}],
}
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


def written(tmp_path, content, name="file.yaml"):
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return path


def test_everything_in_a_machine_file_is_read(tmp_path):
    machine = load_machine(written(tmp_path, MACHINE))
    assert (machine.name, machine.urdf) == ("mill 1", tmp_path / "mill.urdf")
    assert machine.up.tolist() == [0.0, 0.0, 1.0]
    assert machine.uncertainty == MachineUncertainty(stop_sigma_mm=0.003)
    assert machine.dynamics == {
        "X": AxisDynamics(velocity=1000.0, acceleration=3000.0, jerk=30000.0),
        "B": AxisDynamics(velocity=1.0),
    }
    assert machine.follows == {"Y2": Follows(leader="Y", tolerance=0.02)}
    assert machine.ignored == {"W"}
    assert machine.timing == Timing(settling_s=0.3, image_s=0.5)


@pytest.mark.parametrize("start", ["", "\ufeff", "\n <!-- a mill -->"])
def test_a_urdf_is_told_by_its_content(tmp_path, start):
    path = written(tmp_path, f"{start}<robot name='m'/>", "machine.yaml")
    assert load_machine(path).urdf == path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("urdf: mill.urdf, ", "", "'urdf' is missing"),
        ("up: [0, 0, 2]", "up: [0, 0, 0]", "direction"),
        ("stop_sigma_mm: 0.003", "stop_sigma_mm: -0.003", ">= 0"),
        ("geometry_length_mm: null", "geometry_length_mm: 0", "above 0"),
        ("velocity_mm_per_s: 1000", "velocity_mm_per_s: 0", "above 0"),
        ("{ignored: true}", "{ignored: 1}", "true or false"),
        ("W: {ignored: true}", "Y: {ignored: true}", "got both"),
        ("follows: Y,", "follows: Y2,", "got itself"),
        ("settling_s: 0.3", "settling_s: soon", "finite number"),
    ],
)
def test_a_wrong_machine_file_is_refused_by_key(tmp_path, old, new, message):
    assert old in MACHINE
    with pytest.raises(InputError, match=message):
        load_machine(written(tmp_path, MACHINE.replace(old, new)))


def test_a_misspelt_key_is_told(tmp_path, capsys):
    load_machine(written(tmp_path, MACHINE.replace("stop_sigma_mm", "stop_sigma_um")))
    told = capsys.readouterr().err
    assert told.startswith("omm: warning:")
    assert "'stop_sigma_um' is not known and not read (nearest known one: stop_sigma_mm)" in told


def test_no_machine_at_all_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_machine(tmp_path / "none.yaml")


def test_what_a_part_may_say_besides_is_read(tmp_path):
    part = load_part(written(tmp_path, PART | WISHES))
    assert part.box().tolist() == [[0, 0, 0], [1500, 1000, 500]]
    assert part.nominal is not None
    assert part.nominal.translation_mm == (100.0, None, 50.0)
    assert part.nominal.euler_xyz_rad == (None, None, None)
    assert not part.nominal.complete()
    assert list(part.tolerances.items()) == [("alpha_rad", 5e-5), ("z_mm", 1.0)]
    assert [(j.name, j.travel_mm) for j in part.jacks] == [("J1", (-20.0, 20.0))]


def test_a_part_that_says_no_more_has_the_box_of_its_targets(tmp_path):
    part = load_part(written(tmp_path, PART))
    assert part.box().tolist() == [[0, 0, -8], [1500, 1000, 11]]
    assert {tuple(c) for c in part.box_corners()} >= {(0, 0, -8), (1500, 1000, 11), (0, 1000, 11)}
    assert (part.nominal, part.tolerances, part.jacks) == (None, {}, ())


def test_no_sigma_is_exact_and_told_while_zero_is_exact(tmp_path):
    part = load_part(written(tmp_path, PART))
    assert part.taken_as_exact() == (42,)
    assert np.diag(part.target_covariance_mm2()).tolist() == [0, 0, 0, 0, 0, 0, 1, 4, 9]


def test_the_full_covariance_that_fit_writes_comes_back(tmp_path):
    factor = np.random.default_rng(3).normal(size=(9, 9)) * 0.01
    bare = load_part(written(tmp_path, PART))
    targets = tuple(dataclasses.replace(target, sigma_xyz_mm=None) for target in bare.targets)
    given = dataclasses.replace(bare, targets=targets, covariance_mm2=factor @ factor.T)
    part = load_part(written(tmp_path, part_yaml(given)))
    assert np.allclose(part.target_covariance_mm2(), factor @ factor.T, rtol=1e-9, atol=1e-15)
    assert part.taken_as_exact() == ()


def test_all_that_a_part_says_is_written_and_comes_back(tmp_path):
    first = load_part(written(tmp_path, PART | WISHES))
    text = part_yaml(first)
    second = load_part(Text(name="part", content=text.encode()))
    assert second.nominal == first.nominal
    assert second.tolerances == first.tolerances
    assert [jack.travel_mm for jack in second.jacks] == [jack.travel_mm for jack in first.jacks]
    assert part_yaml(second) == text


def test_a_sigma_that_contradicts_the_covariance_is_told(tmp_path, capsys):
    load_part(written(tmp_path, PART | {"covariance_mm2": np.eye(9).tolist()}))
    err = capsys.readouterr().err
    assert "target 8" in err
    assert "target 42" not in err


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("covariance_mm2", np.eye(6).tolist(), "9 rows"),
        ("covariance_mm2", (-np.eye(9)).tolist(), "negative variances"),
        ("box_mm", [[0, 0, 0]], "two corners"),
        ("box_mm", [[0, 0, 9], [1, 1, 1]], "lowest corner"),
        ("nominal", {"translation_mm": [1, 2]}, "3 numbers or nulls"),
        ("tolerances", {"z": 1}, "alpha_rad"),
        ("tolerances", {"z_mm": 0}, "above 0"),
        ("jacks", {"name": "J1"}, "list"),
        ("jacks", [{"name": "J", "xyz_mm": [0, 0, 0], "travel_mm": [2, 1]}], "lowest, highest"),
    ],
)
def test_a_wrong_key_of_a_part_is_refused(tmp_path, key, value, message):
    with pytest.raises(InputError, match=message):
        load_part(written(tmp_path, PART | {key: value}))


def test_what_a_camera_may_say_besides_is_read(tmp_path):
    bare = load_calibration(written(tmp_path, CAMERA))
    assert (bare.imaging.focus_mm, bare.imaging.max_tilt_rad, bare.body) == (None, None, None)
    calibration = load_calibration(written(tmp_path, CAMERA | {
        "imaging": {"exposure_s": 0.01, "focus_mm": [140, 400], "max_tilt_rad": 0.9},
        "body": {"radius_mm": 60, "z_mm": [-330, 0]},
    }))  # fmt: skip
    assert calibration.imaging.focus_mm == (140.0, 400.0)
    assert calibration.imaging.max_tilt_rad == 0.9
    assert calibration.body is not None
    assert calibration.body.z_mm == (-330.0, 0.0)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("imaging", {"focus_mm": [400, 140]}, "smaller, larger"),
        ("imaging", {"max_tilt_rad": 50}, "degrees"),
        ("imaging", {"exposure_s": 0}, "above 0"),
        ("body", {"z_mm": [-330, 0]}, "'radius_mm' is missing"),
    ],
)
def test_a_wrong_key_of_a_camera_is_refused(tmp_path, key, value, message):
    with pytest.raises(InputError, match=message):
        load_calibration(written(tmp_path, CAMERA | {key: value}))
