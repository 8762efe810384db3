"""Between rclpy's objects and the recorder's."""

from importlib import import_module
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from omm_core.errors import InputError
from omm_recording.rosbag2_format import TopicQos


def message_class(type_name: str) -> Any:
    """Return the class of a message type such as ``sensor_msgs/msg/Image``.

    Raises
    ------
    InputError
        If its package is not installed.
    """
    package, _, name = type_name.partition("/msg/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise InputError(
            f"Expected the messages {type_name} to be installed: {error}. "
            "Source the workspace that they are in."
        ) from error


def as_installed(message_type: Any, recorded: Any) -> Any:
    """Return a message of the installed type with what a recorded one of another version holds.

    Fields that one of the two lacks are left out, or stay as the type has them.
    """
    message = message_type()
    for name, kind in message_type.get_fields_and_field_types().items():
        if hasattr(recorded, name):
            setattr(message, name, _value_as_installed(kind, getattr(recorded, name)))
    return message


def _value_as_installed(kind: str, value: Any) -> Any:
    element = kind.removeprefix("sequence<").partition(">")[0].partition("[")[0].partition(",")[0]
    if "/" not in element:
        return (
            value.tolist() if kind.startswith("sequence<") and hasattr(value, "tolist") else value
        )
    package, _, name = element.partition("/")
    element_type = getattr(import_module(f"{package}.msg"), name)
    if kind == element:
        return as_installed(element_type, value)
    return [as_installed(element_type, one) for one in value]


def profile_from_qos(qos: TopicQos) -> QoSProfile:
    """Return the profile to subscribe or publish with."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE),
    )


def qos_from_profile(profile: QoSProfile, depth: int) -> TopicQos:
    """Return what matters of a publisher's profile; the network does not tell its depth."""
    return TopicQos(
        reliable=profile.reliability != ReliabilityPolicy.BEST_EFFORT,
        latched=profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        depth=depth,
    )
