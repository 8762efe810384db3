"""Messages from their bytes, by the definition that stands in the recording; no ROS needed."""

import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from omm_core.errors import InputError, warn
from omm_core.geometry import RigidTransform
from omm_core.imaging.encodings import grey_image, liberties

IMAGE_TYPE = "sensor_msgs/msg/Image"
POSE_TYPE = "geometry_msgs/msg/PoseStamped"

_NAME = re.compile(r"[A-Za-z]\w*/([A-Za-z]\w*/)?[A-Za-z]\w*", re.ASCII)
_LONGEST_DEFINITION = 1 << 18


def decoder(type_name: str, encoding: str, definition: str) -> Callable[[Any], Any]:
    """Make the function that turns the CDR bytes of one type into an object with its fields.

    Parameters
    ----------
    type_name
        Such as ``sensor_msgs/msg/Image``.
    encoding
        Of the definition: ``ros2msg``, ``ros2idl``, or empty where the recording carries none
        (then the definition that Jazzy has is used).
    definition
        The text of the schema.

    Raises
    ------
    InputError
        If the definition cannot be understood.
    """
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    # Code is made of both: names are names, and the text is as long as definitions are.
    if not _NAME.fullmatch(type_name):
        raise InputError(f"Expected the name of a type such as {POSE_TYPE}, got {type_name!r:.99}.")
    if len(definition) > _LONGEST_DEFINITION:
        raise InputError(f"The definition of {type_name} is too long to be one.")
    if not definition:
        return _from_jazzy(type_name)
    parse = {"ros2msg": get_types_from_msg, "ros2idl": lambda text, _: get_types_from_idl(text)}
    if encoding not in parse:
        raise InputError(
            f"Expected the definition of {type_name} as ros2msg or ros2idl, got {encoding!r}. "
            "Convert the recording to ROS 2 first, for instance with rosbags-convert."
        )
    try:
        store = get_typestore(Stores.EMPTY)
        store.register(parse[encoding](definition, type_name))
        store.get_msgdef(type_name)
    except Exception as error:  # the parser's errors have no common base
        raise InputError(
            f"The recording's definition of {type_name} is not readable: {error}"
        ) from error
    return lambda data: _deserialised(store, data, type_name)


def _from_jazzy(type_name: str) -> Callable[[Any], Any]:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    if type_name not in store.fielddefs:
        raise InputError(f"The recording holds no definition of {type_name}, and Jazzy knows none.")
    return lambda data: _deserialised(store, data, type_name)


def _deserialised(store: Any, data: Any, type_name: str) -> Any:
    try:
        return store.deserialize_cdr(data, type_name)
    except Exception as error:  # struct, unicode and index errors, by where the bytes end
        raise InputError(f"A message of type {type_name} is damaged: {error}") from error


def stamp_ns(message: Any) -> int:
    """Return the stamp in a message's header, in nanoseconds."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def image_pixels(message: Any) -> np.ndarray:
    """Return the pixels of an image message: (height, width) uint8 or uint16, grey.

    Raises
    ------
    InputError
        If its encoding is not known, or its sizes contradict each other.
    """
    if liberty := liberties(message.encoding, int(message.step)):
        _tell_once(liberty)
    return grey_image(
        np.asarray(message.data),
        message.encoding,
        height_px=int(message.height),
        width_px=int(message.width),
        step_bytes=int(message.step),
        big_endian=bool(message.is_bigendian),
    )


@cache
def _tell_once(liberty: str) -> None:
    warn(liberty)


def machine_T_spindle(message: Any) -> RigidTransform:
    """Return the spindle's pose from a ``geometry_msgs/PoseStamped`` (m), in mm.

    Raises
    ------
    InputError
        If the quaternion has no direction, or a number is not finite.
    """
    p, q = message.pose.position, message.pose.orientation
    xyz_mm = np.array((p.x, p.y, p.z)) * 1000.0
    return RigidTransform.from_quaternion_xyzw((q.x, q.y, q.z, q.w), xyz_mm)
