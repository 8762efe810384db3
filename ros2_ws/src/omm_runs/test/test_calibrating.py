"""A set's files are read, judged and end in a camera.yaml that loads as it was solved."""

import json
from pathlib import Path

import numpy as np
import pytest

from omm_core.camera_calibration.model import PARAMETERS, Sensor, project_with_derivatives
from omm_core.camera_calibration.single_dot import SingleDot
from omm_core.errors import InputError
from omm_core.files.calibration_set import load_calibration_set
from omm_core.geometry import rotation_from_euler_xyz_rad
from omm_core.imaging.calibration import load_calibration
from omm_core.imaging.circle import circle_points
from omm_runs.calibrating import calibrate_set, camera_file
from omm_runs.dot_images import likely_dots, nearest_dots, without_what_stands_still

TRUTH = np.array(
    [6.189, -8.732, 27.52, 2.997e-8, -1.937e-15, -6.188e-8, 3.408e-7,
     -2.139, 0.301, -320.2, np.pi - 0.003, -0.009, 0.03]
)  # fmt: skip
SET = """kind: cmm
camera: {name: test, width_px: 2592, height_px: 1944, pixel_size_mm: 0.0022}
model: brown_photogrammetric
points: points.csv
target: {dot_diameter_mm: 5.0, normal: [0, 0, 1]}
sigma_xyz_mm: 0.001
sigma_px: 0.02
"""


@pytest.fixture
def folder(tmp_path):
    sensor = Sensor(name="test", width_px=2592, height_px=1944, pixel_size_mm=0.0022)
    grid = np.stack(np.meshgrid(np.linspace(150, 2440, 6), np.linspace(150, 1790, 5)), axis=-1)
    rays = sensor.lens(TRUTH).rays(grid.reshape(-1, 2))
    rotation = rotation_from_euler_xyz_rad(*TRUTH[10:])
    places = np.concatenate([rays * d @ rotation.T + TRUTH[7:10] for d in (130, 250, 500)])
    normals = np.tile([0.0, 0.0, 1.0], (len(places), 1))
    outlines = circle_points(places, normals, np.full(len(places), 5.0))
    pixels = project_with_derivatives(sensor, TRUTH, outlines)[0]
    pixels = pixels + np.random.default_rng(0).normal(0, 0.02, pixels.shape)
    lines = ["image,x_mm,y_mm,z_mm,col_px,row_px"]
    for number, (place, pixel) in enumerate(zip(places, pixels, strict=True)):
        lines.append(f"{number}.png," + ",".join(f"{v:.6f}" for v in (*place, *pixel)))
    (tmp_path / "points.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "set.yaml").write_text(SET)
    return tmp_path


def test_the_camera_file_loads_as_it_was_solved(folder):
    given, result = calibrate_set(folder)
    (folder / "camera.yaml").write_text(camera_file(given, result))
    loaded = load_calibration(folder / "camera.yaml")
    assert loaded.parameters == PARAMETERS
    # alpha is read back modulo a turn.
    assert loaded.parameter_values(PARAMETERS[:10]) == pytest.approx(result.camera[:10], rel=1e-12)
    rotation = rotation_from_euler_xyz_rad(*result.camera[10:])
    assert loaded.taper_T_camera.rotation == pytest.approx(rotation, abs=1e-14)
    assert loaded.covariance == pytest.approx(result.covariance, rel=1e-9)
    assert loaded.covered.distance_mm == pytest.approx(result.covered_mm, abs=0.1)
    assert loaded.covered.low_px == pytest.approx(result.covered_px[0], abs=0.1)


def test_what_a_calibration_does_not_measure_is_carried_over_from_the_hint(folder):
    given, result = calibrate_set(folder)
    hint = camera_file(given, result) + "imaging: {focus_mm: [150, 600]}\n"
    (folder / "old.yaml").write_text(hint + "body: {radius_mm: 40, z_mm: [-330, 0]}\n")
    (folder / "set.yaml").write_text(SET + "nominal: old.yaml\ntemperature_C: 20.5\n")
    given, result = calibrate_set(folder)
    (folder / "new.yaml").write_text(camera_file(given, result))
    loaded = load_calibration(folder / "new.yaml")
    assert loaded.imaging.focus_mm == (150, 600)
    assert loaded.body.radius_mm == 40
    assert "temperature_C: 20.5" in (folder / "new.yaml").read_text()


def test_the_json_is_as_the_contract_has_it(folder):
    _, result = calibrate_set(folder / "set.yaml")
    told = json.loads(json.dumps(result.to_json_dict(), allow_nan=False))
    assert told["parameters"] == list(PARAMETERS)
    assert np.shape(told["covariance"]) == (13, 13)
    assert told["degrees_of_freedom"] == 2 * 90 - 13
    assert {"image", "col_px", "row_px", "residual_px", "used", "reason"} <= set(
        told["observations"][0]
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("kind: cmm", "kind: cmn", "'cmm' or 'machine'"),
        ("brown_photogrammetric", "plumb_bob", "brown_photogrammetric"),
        ("normal: [0, 0, 1]", "normal: [0, 0, 0]", "a direction"),
        ("sigma_px: 0.02", "", "sigma_px"),
        ("points.csv", "none.csv", "no such file"),
        ("pixel_size_mm: 0.0022", "pixel_size_mm: 2.2", "2.2 µm are 0.0022 mm"),
    ],
)
def test_mistakes_in_a_set_are_named(folder, old, new, words):
    (folder / "set.yaml").write_text(SET.replace(old, new))
    with pytest.raises(InputError, match=words):
        load_calibration_set(folder)


def test_a_place_that_is_no_number_is_named_by_line(folder):
    text = (folder / "points.csv").read_text().splitlines()
    text[4] = text[4].replace(text[4].split(",")[1], "abc")
    (folder / "points.csv").write_text("\n".join(text))
    with pytest.raises(InputError, match=r"line 5.*x_mm.*abc"):
        load_calibration_set(folder)


def test_a_table_may_have_spaces(folder):
    text = (folder / "points.csv").read_text()
    wanted = load_calibration_set(folder)
    (folder / "points.csv").write_text(text.replace(",", ", "))
    assert load_calibration_set(folder).places_mm == pytest.approx(wanted.places_mm)


def test_the_shared_images_are_calibrated_within_what_is_told():
    folder = Path(__file__).parents[4].parent / "shared" / "data" / "calibration" / "cmm_images"
    if not (folder / "truth.json").exists():
        pytest.skip("needs ../shared/data/calibration, which is not here")
    truth = json.loads((folder / "truth.json").read_text())["parameters"]
    _, result = calibrate_set(folder)
    error = result.camera - np.array([truth[name] for name in PARAMETERS])
    assert np.abs(error / np.sqrt(np.diag(result.covariance))).max() < 4.0


def dot(col, row, diameter=20.0):
    centre = np.array([col, row])
    return SingleDot(center_px=centre, covariance_px2=np.eye(2) * 1e-4, diameter_px=diameter)


def test_a_reflection_that_stands_still_is_not_the_dot():
    places = [(100.0 * i, 50.0 * i) for i in range(1, 13)]
    dots = [[dot(700.5, 300.2, 40.0), dot(*place)] for place in places]
    chosen = likely_dots(without_what_stands_still(dots), least=8)
    assert [tuple(one.center_px) for one in chosen] == places


def test_with_few_images_of_one_thing_alone_the_largest_is_taken_to_begin_with():
    dots = [[dot(100 * i, 50, 20.0), dot(90 * i, 700 - i * 40, 8.0)] for i in range(1, 6)]
    chosen = likely_dots([*dots, []], least=8)
    assert [one and one.diameter_px for one in chosen] == [20.0] * 5 + [None]


def test_the_dot_is_the_one_that_is_where_it_must_be():
    dots = [[dot(500, 500), dot(100, 101)], [dot(900, 900)], []]
    predicted = np.array([[100.0, 100.0], [400.0, 400.0], [50.0, 50.0]])
    chosen = nearest_dots(dots, predicted, 20.0)
    assert chosen == [dots[0][1], None, None]


def test_centres_that_are_not_on_the_sensor_are_named(folder):
    (folder / "set.yaml").write_text(SET.replace("width_px: 2592", "width_px: 1000"))
    with pytest.raises(InputError, match="within 1000 x 1944 pixels, got"):
        calibrate_set(folder)
