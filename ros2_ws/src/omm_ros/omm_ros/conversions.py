"""Between ROS messages (m, rad, stamps) and the core (mm, rad, nanoseconds)."""

import sys

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, Transform
from numpy.typing import NDArray
from sensor_msgs.msg import Image

from omm_core.errors import InputError
from omm_core.geometry import RigidTransform
from omm_core.imaging.encodings import Pixels, grey_image

MM_PER_M = 1000.0


def stamp_ns(stamp: Time) -> int:
    """Return a message's stamp as nanoseconds since the epoch."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def time_from_ns(nanoseconds: int) -> Time:
    """Return a message's stamp from nanoseconds since the epoch."""
    sec, nanosec = divmod(int(nanoseconds), 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def transform_from_pose(pose: Pose) -> RigidTransform:
    """Return `a_T_b` in mm from a pose of b in a, in m.

    Raises
    ------
    InputError
        The quaternion has no direction, or a number is not finite.
    """
    orientation, position = pose.orientation, pose.position
    xyzw = (orientation.x, orientation.y, orientation.z, orientation.w)
    xyz_mm = np.array((position.x, position.y, position.z)) * MM_PER_M
    return RigidTransform.from_quaternion_xyzw(xyzw, xyz_mm)


def pose_from_transform(a_t_b: RigidTransform) -> Pose:
    """Return the pose of b in a, in m."""
    pose = Pose()
    x, y, z = (a_t_b.translation_mm / MM_PER_M).tolist()
    pose.position.x, pose.position.y, pose.position.z = x, y, z
    qx, qy, qz, qw = (float(q) for q in a_t_b.quaternion_xyzw())
    pose.orientation.x, pose.orientation.y = qx, qy
    pose.orientation.z, pose.orientation.w = qz, qw
    return pose


def transform_message(a_t_b: RigidTransform) -> Transform:
    """Return the pose of b in a, in m, as /tf wants it."""
    pose = pose_from_transform(a_t_b)
    transform = Transform(rotation=pose.orientation)
    transform.translation.x = pose.position.x
    transform.translation.y = pose.position.y
    transform.translation.z = pose.position.z
    return transform


def image_from_message(message: Image) -> Pixels:
    """Return the pixels of a message, grey; without a copy where they are monochrome.

    Returns
    -------
    (height, width) uint8 or uint16

    Raises
    ------
    InputError
        The encoding is not known, or the data do not fill the image.
    """
    return grey_image(
        message.data,
        message.encoding,
        height_px=message.height,
        width_px=message.width,
        step_bytes=message.step,
        big_endian=bool(message.is_bigendian),
    )


def image_message(pixels: NDArray[np.generic], stamp_nanoseconds: int, frame_id: str) -> Image:
    """Return a message around the pixels, without a copy.

    They must not change until it is published.

    Parameters
    ----------
    pixels : (height, width) uint8 or uint16, contiguous
    """
    if pixels.ndim != 2 or pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"Expected (height, width) pixels of uint8 or uint16, "
            f"got {pixels.shape} of {pixels.dtype}."
        )
    message = Image()
    message.header.stamp = time_from_ns(stamp_nanoseconds)
    message.header.frame_id = frame_id
    message.height, message.width = pixels.shape
    message.encoding = "mono8" if pixels.dtype == np.uint8 else "mono16"
    message.is_bigendian = int(sys.byteorder == "big")
    message.step = message.width * pixels.itemsize
    flat = np.ascontiguousarray(pixels).reshape(-1).view(np.uint8)
    # The setter of `data` checks a numpy array byte by byte (800 ms for 5 MB); the serialisation
    # itself takes any buffer behind the attribute.
    message._data = flat
    return message
