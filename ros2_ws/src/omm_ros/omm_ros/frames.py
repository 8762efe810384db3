"""Frames of several machines in one tree: every name gets the machine's prefix."""

from typing import Any, TypeVar

M = TypeVar("M", bound=Any)


def prefixed(message: M, prefix: str) -> M:
    """Put the prefix before the frames that a message names, and return the message.

    Parameters
    ----------
    message : with a header, and a child frame where it is a transform
    prefix : as robot_state_publisher's ``frame_prefix``: ``mill1/``
    """
    message.header.frame_id = prefix + message.header.frame_id
    if hasattr(message, "child_frame_id"):
        message.child_frame_id = prefix + message.child_frame_id
    return message
