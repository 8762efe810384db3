"""Environment variables that ROS 2 reads: checked before it does, in words that help.

rclpy tells of a bad one with a traceback, or ends the process; so this imports nothing of it.
"""

import os
import socket
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

from ament_index_python import get_resources

from omm_core.errors import InputError, did_you_mean
from omm_core.files.outside import read_bytes

LARGEST_DOMAIN = 232  # above it, the ports of DDS end
PROFILE_VARIABLES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
_PROFILE_ROOTS = ("dds", "profiles")
_RANGES = ("OFF", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT")
_WITHOUT_PEERS = ("OFF", "SYSTEM_DEFAULT")
# Switches of ROS 2. Another word floods the screen with messages about it, or counts as no.
_SWITCHES = (
    "ROS_LOCALHOST_ONLY",
    "RCUTILS_COLORIZED_OUTPUT",
    "RCUTILS_LOGGING_USE_STDOUT",
    "RCUTILS_LOGGING_BUFFERED_STREAM",
)
_LOGS_BELOW = {"ROS_LOG_DIR": "", "ROS_HOME": "log", "HOME": ".ros/log"}  # the first that is set


def check_environment(*, discovery: bool = True) -> None:
    """Raise InputError where a variable keeps ROS 2 from starting, naming it and what to do.

    So, too, where ROS 2 would start, but not as somebody wanted it: a misspelt range, a profile
    that is not there (without which the interfaces are open).

    Parameters
    ----------
    discovery : false where range and peers are set anew before ROS 2 starts
    """
    _check_middleware(os.environ.get("RMW_IMPLEMENTATION", ""))
    _check_domain(os.environ.get("ROS_DOMAIN_ID", ""))
    for name in _SWITCHES:
        _check_switch(name, os.environ.get(name, ""))
    if discovery:
        _check_discovery()
    for name in PROFILE_VARIABLES:
        _check_profile(name, os.environ.get(name, ""))
    _check_log_folder()


def _check_switch(name: str, text: str) -> None:
    if text not in ("", "0", "1"):
        raise InputError(f"{name}: expected 0 or 1, got {text!r}. Set it to one of them.")


def _check_discovery() -> None:
    text = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if text and text not in _RANGES:
        raise InputError(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE: expected one of {', '.join(_RANGES)}; got {text!r}."
            f"{did_you_mean(text.upper(), _RANGES)}"
        )
    if text not in _WITHOUT_PEERS and os.environ.get("ROS_LOCALHOST_ONLY") != "1":
        for peer in os.environ.get("ROS_STATIC_PEERS", "").split(";"):
            _check_peer(peer)


def _check_peer(peer: str) -> None:
    try:
        if peer:
            socket.getaddrinfo(peer, None)
    # The second: a name that cannot be written as a host's.
    except (OSError, UnicodeError) as error:
        raise InputError(
            "ROS_STATIC_PEERS: expected addresses or names of computers, separated by semicolons;"
            f" got {peer!r}, which cannot be found ({getattr(error, 'strerror', error)}). Correct"
            " it, or use the computer's address."
        ) from error


def _check_profile(name: str, path: str) -> None:
    """Refuse a profile that Fast DDS would pass over: it would go on with open interfaces."""
    if not path:
        return
    way_out = "Correct it, or unset it: then omm's own profile is used."
    try:
        root = ET.fromstring(read_bytes(path, "profile for Fast DDS"))
    # The last two: an encoding that Python does not know.
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InputError(
            f"{name}: expected XML in {path}, got an error: {error}. {way_out}"
        ) from error
    except InputError as error:
        raise InputError(f"{name}: {error} {way_out}") from error
    if root.tag.rpartition("}")[2] not in _PROFILE_ROOTS:
        raise InputError(
            f"{name}: expected the element {' or '.join(_PROFILE_ROOTS)} in {path}, got {root.tag}."
            f" {way_out}"
        )


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
