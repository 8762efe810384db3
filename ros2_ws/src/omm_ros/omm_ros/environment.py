"""Environment variables that ROS 2 reads: checked before it does, in words that help.

rclpy tells of a bad one with a traceback, or ends the process; so this imports nothing of it.
"""

import os
import tempfile
from pathlib import Path

from ament_index_python import get_resources

from omm_core.errors import InputError

LARGEST_DOMAIN = 232  # above it, the ports of DDS end
_LOGS_BELOW = {"ROS_LOG_DIR": "", "ROS_HOME": "log", "HOME": ".ros/log"}  # the first that is set


def check_environment() -> None:
    """Raise InputError where a variable keeps ROS 2 from starting, naming it and what to do."""
    _check_middleware(os.environ.get("RMW_IMPLEMENTATION", ""))
    _check_domain(os.environ.get("ROS_DOMAIN_ID", ""))
    _check_log_folder()


def _check_middleware(name: str) -> None:
    installed = sorted(set(get_resources("rmw_typesupport")) - {"rmw_implementation"})
    if name and installed and name not in installed:
        raise InputError(
            f"RMW_IMPLEMENTATION: expected {' or '.join(installed)} (installed here), got {name}. "
            "Unset it, or install that one."
        )


def _check_domain(text: str) -> None:
    if text and not (text.isascii() and text.isdigit() and int(text) <= LARGEST_DOMAIN):
        raise InputError(
            f"ROS_DOMAIN_ID: expected a whole number from 0 to {LARGEST_DOMAIN}, got {text!r}. "
            "Set it to the one that your other ROS 2 programs have, or unset it."
        )


def _check_log_folder() -> None:
    """Make ROS's log folder (ROS_LOG_DIR, or below ROS_HOME, HOME); check that it is writable."""
    variable = next((name for name in _LOGS_BELOW if os.environ.get(name)), None)
    if variable is None:
        raise InputError(
            "ROS_LOG_DIR: expected a folder that logs can be written to, got neither it nor"
            " ROS_HOME nor HOME. Set it to a folder of yours."
        )
    folder = Path(os.environ[variable]).expanduser() / _LOGS_BELOW[variable]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"{variable}: expected a folder that logs can be written to, got {folder}: "
            f"{error.strerror}. Set {_way_out(variable)}."
        ) from error


def _way_out(variable: str) -> str:
    known = "ROS_LOG_DIR to a folder of yours"
    return known if variable == "HOME" else "it to a folder of yours, or unset it"
