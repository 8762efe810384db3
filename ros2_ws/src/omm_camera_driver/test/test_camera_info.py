"""camera_info says what the calibration says, in ROS's words, from either kind of file."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from omm_camera_driver import camera_info
from omm_core.errors import InputError
from omm_core.imaging.calibration import load_calibration
from omm_simulation.scenario import load_scenario

# As camera_calibration writes it (its tutorial's file, shortened).
ROS_YAML = """
image_width: 2592
image_height: 1944
camera_name: dmk
camera_matrix: {rows: 3, cols: 3, data: [7272.5, 0.0, 1290.1, 0.0, 7270.0, 970.2, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.11, 0.2, 0.0004, -0.0003, 0.01]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [7272.5, 0, 1290.1, 0, 0, 7270, 970.2, 0, 0, 0, 1, 0]}
"""


@pytest.fixture
def ros_file(tmp_path: Path) -> Path:
    path = tmp_path / "my camera.yaml"
    path.write_text(ROS_YAML)
    return path


def test_a_ros_calibration_is_passed_on_as_it_is(ros_file: Path) -> None:
    source = camera_info.from_url(ros_file.as_uri())  # with %20 for the space
    message = source.message
    assert (message.width, message.height, message.distortion_model) == (2592, 1944, "plumb_bob")
    assert list(message.k) == [7272.5, 0.0, 1290.1, 0.0, 7270.0, 970.2, 0.0, 0.0, 1.0]
    assert list(message.d) == [-0.11, 0.2, 0.0004, -0.0003, 0.01]
    assert list(message.p)[:3] == [7272.5, 0.0, 1290.1]
    assert source.largest_error_px == 0.0


def test_a_package_address_is_looked_up() -> None:
    with pytest.raises(InputError, match="no package omm_nowhere"):
        camera_info.from_url("package://omm_nowhere/camera.yaml")
    with pytest.raises(InputError, match="omm_simulation"):  # the package is there, the file not
        camera_info.from_url("package://omm_simulation/none.yaml")


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("http://host/camera.yaml", "expected file:///"),
        ("camera.yaml", "expected file:///"),
        ("file:///nowhere/camera.yaml", "/nowhere/camera.yaml"),
    ],
)
def test_an_address_that_cannot_be_used_is_told(url: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        camera_info.from_url(url)


@pytest.mark.parametrize(
    ("changed", "into", "told"),
    [
        ("plumb_bob", "equidistant", "expected distortion_model plumb_bob, got equidistant"),
        ("[-0.11, 0.2, 0.0004, -0.0003, 0.01]", "[-0.11, 0.2]", "distortion_coefficients"),
        ("image_width: 2592", "image_width: 0", "image_width"),
        ("camera_matrix", "matrix", "camera_matrix"),
    ],
)
def test_a_file_that_is_not_right_is_told(
    ros_file: Path, changed: str, into: str, told: str
) -> None:
    ros_file.write_text(ROS_YAML.replace(changed, into, 1))
    with pytest.raises(InputError, match=told):
        camera_info.from_url(ros_file.as_uri())


def test_the_message_of_a_calibration_undistorts_within_the_error_it_tells() -> None:
    """Seen by OpenCV, as `image_proc` does, against the calibration's own lens."""
    path = load_scenario("bench").calibration_file
    lens = load_calibration(path).lens
    source = camera_info.from_calibration(str(path))
    cols, rows = np.meshgrid(
        np.linspace(0, lens.width_px - 1, 25), np.linspace(0, lens.height_px - 1, 19)
    )
    pixels = np.column_stack([cols.ravel(), rows.ravel()])
    rays = lens.rays(pixels)
    seen, _ = cv2.projectPoints(
        rays / rays[:, 2:],
        np.zeros(3),
        np.zeros(3),
        np.array(source.message.k).reshape(3, 3),
        np.array(source.message.d),
    )
    largest = np.abs(seen[:, 0] - pixels).max()
    assert largest <= 1.1 * source.largest_error_px + 1e-9
    assert source.largest_error_px < 0.25  # for looking at images; measuring uses the calibration


def test_without_a_calibration_it_says_so_as_ros_does() -> None:
    assert camera_info.uncalibrated().message.k[0] == 0.0


def test_what_camera_calibration_sends_is_kept_and_read_back_at_the_next_start(
    ros_file: Path, tmp_path: Path
) -> None:
    sent = camera_info.from_url(ros_file.as_uri()).message
    kept = tmp_path / "kept.yaml"
    told = camera_info.keep(kept.as_uri(), sent).message
    again = camera_info.from_url(kept.as_uri()).message
    for of in (told, again):
        assert (of.width, of.height) == (sent.width, sent.height)
        assert list(of.k) == list(sent.k)
        assert list(of.d) == list(sent.d)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"distortion_model": "fisheye"}, "Expected a plumb_bob calibration with 5"),
        ({"d": [0.0] * 8}, "Expected a plumb_bob calibration with 5"),
        ({"k": [0.0] * 9}, "Expected a calibration with a focal length"),
        ({"d": [float("nan")] * 5}, "finite numbers"),
    ],
)
def test_a_calibration_that_cannot_be_used_is_not_kept(
    ros_file: Path, tmp_path: Path, changed: dict[str, object], told: str
) -> None:
    message = camera_info.from_url(ros_file.as_uri()).message
    for name, value in changed.items():
        setattr(message, name, value)
    with pytest.raises(InputError, match=told):
        camera_info.keep((tmp_path / "kept.yaml").as_uri(), message)
    assert not (tmp_path / "kept.yaml").exists()


def test_a_region_of_the_sensor_keeps_the_calibration_and_says_where_it_is(ros_file: Path) -> None:
    whole = camera_info.from_url(ros_file.as_uri()).message
    info = camera_info.for_image(whole, (640, 480), (16, 8))
    assert (info.k[0], info.width) == (7272.5, 2592)
    assert (info.roi.x_offset, info.roi.y_offset) == (16, 8)
    assert (info.roi.width, info.roi.height) == (640, 480)
    assert whole.roi.width == 0  # the next image may be whole again
    assert camera_info.for_image(whole, (2592, 1944), (0, 0)).roi.width == 0


def test_binned_or_scaled_images_are_not_said_to_be_calibrated(ros_file: Path) -> None:
    whole = camera_info.from_url(ros_file.as_uri()).message
    info = camera_info.for_image(whole, (1296, 972), None)
    assert (info.k[0], info.width, info.height, info.roi.width) == (0.0, 1296, 972, 0)
    unknown = camera_info.for_image(camera_info.uncalibrated().message, (5, 4), None)
    assert (unknown.k[0], unknown.width, unknown.height) == (0.0, 5, 4)
