"""Who recorded, where and with what."""

import getpass
import os
import platform
import socket
from importlib import metadata

_LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "mcap", "rosbags", "zstandard")


def provenance() -> dict[str, str]:
    """Return the versions of omm, ROS, Python and the libraries, and who runs them where."""
    values = {
        "omm": _version("omm_core"),
        "ros_distro": os.environ.get("ROS_DISTRO", "jazzy"),
        "rclpy": _version("rclpy"),
        "rmw": _middleware(),
        "python": platform.python_version(),
        "system": platform.platform(),
        "host": socket.gethostname(),
        "user": _user(),
    }
    values.update({name: _version(name) for name in _LIBRARIES})
    return values


def _version(name: str) -> str:
    for candidate in (name, name.replace("_", "-"), f"ros-jazzy-{name}"):
        try:
            return metadata.version(candidate)
        except metadata.PackageNotFoundError:
            continue
    return "unknown"


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without an entry, as in containers
        return str(os.getuid())


def _middleware() -> str:
    from rclpy import get_rmw_implementation_identifier

    return str(get_rmw_implementation_identifier())
