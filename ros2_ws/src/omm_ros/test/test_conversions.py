"""Messages and core types carry the same meaning."""

import numpy as np
import pytest
from geometry_msgs.msg import Pose
from sensor_msgs.msg import Image

from omm_core.errors import InputError
from omm_core.geometry import RigidTransform
from omm_ros.conversions import (
    image_from_message,
    image_message,
    pose_from_transform,
    stamp_ns,
    time_from_ns,
    transform_from_pose,
)

RNG = np.random.default_rng(1)


def test_stamps_survive_to_the_nanosecond() -> None:
    for nanoseconds in (0, 1, 999_999_999, 1_700_000_001_176_970_287):
        assert stamp_ns(time_from_ns(nanoseconds)) == nanoseconds


def test_poses_survive_and_change_their_unit() -> None:
    a_t_b = RigidTransform.from_euler_xyz_rad(0.1, -0.2, 3.0, (1500.0, -20.0, 0.5))
    pose = pose_from_transform(a_t_b)
    again = transform_from_pose(pose)
    assert pose.position.x == pytest.approx(1.5)
    np.testing.assert_allclose(again.translation_mm, a_t_b.translation_mm, atol=1e-12)
    np.testing.assert_allclose(again.rotation, a_t_b.rotation, atol=1e-15)


def test_a_pose_that_is_none_is_refused() -> None:
    pose = Pose()
    pose.position.x = float("nan")
    with pytest.raises(InputError):
        transform_from_pose(pose)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_images_survive_to_the_bit(dtype: type) -> None:
    pixels = RNG.integers(0, np.iinfo(dtype).max, (7, 5)).astype(dtype)
    message = image_message(pixels, 12, "camera_optical")
    np.testing.assert_array_equal(image_from_message(message), pixels)
    assert message.header.frame_id == "camera_optical"


def test_padding_and_the_other_byte_order_are_understood() -> None:
    pixels = RNG.integers(0, 65535, (4, 3)).astype(np.uint16)
    padded = np.zeros((4, 10), dtype=np.uint8)
    padded[:, :6] = pixels.astype(">u2").view(np.uint8).reshape(4, 6)
    message = Image(height=4, width=3, step=10, encoding="mono16", is_bigendian=1)
    message.data = padded.tobytes()
    np.testing.assert_array_equal(image_from_message(message), pixels)


@pytest.mark.parametrize(("encoding", "size"), [("rgb8", 16), ("mono8", 15), ("mono8", 0)], ids=str)
def test_an_image_that_cannot_be_one_is_refused_with_what_was_expected(
    encoding: str, size: int
) -> None:
    message = Image(height=4, width=4, step=4, encoding=encoding)
    message.data = bytes(size)
    with pytest.raises(InputError, match="Expected"):
        image_from_message(message)
