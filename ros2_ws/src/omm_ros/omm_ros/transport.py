"""Middleware settings without which 5 MB images get lost or slow, and strangers listen.

Measured with rclpy on two cores: the default transports deliver 7-18 % of 20 images/s (best effort)
or need 40 ms each; with a shared-memory segment large enough for images, and a C library that keeps
large blocks instead of returning them to the kernel after every image, all arrive in 6 ms.

Nothing leaves this machine unless it is asked for: a discovery that stays here does not keep others
out (a peer that knows the address gets everything), so the interfaces are limited to loopback. The
parameter ``network`` of a node, or OMM_NETWORK=1, opens them.
"""

import ctypes
import itertools
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from omm_core.errors import InputError
from omm_core.files.yaml_input import read_yaml
from omm_ros.environment import PROFILE_VARIABLES
from omm_ros.shared_memory import remove_leftovers

# glibc, malloc.h
_M_TRIM_THRESHOLD = -1
_M_TOP_PAD = -2
_M_MMAP_THRESHOLD = -3


def prepare(arguments: list[str] | None = None) -> None:
    """Apply the settings to this process; to be called before `rclpy.init`.

    Parameters
    ----------
    arguments : command line without the program's name; default: the process's
    """
    # One that is set, but empty, would leave the interfaces open.
    if not any(os.environ.get(name) for name in PROFILE_VARIABLES):
        words = sys.argv[1:] if arguments is None else arguments
        opened = os.environ.get("OMM_NETWORK") == "1" or network_is_asked_for(words)
        name = "fastdds_network.xml" if opened else "fastdds.xml"
        profile = str(Path(get_package_share_directory("omm_ros")) / "config" / name)
        for variable in PROFILE_VARIABLES:
            os.environ[variable] = profile
    remove_leftovers()
    _keep_large_blocks()


def network_is_asked_for(words: list[str]) -> bool:
    """Return whether a command line sets ``network``, which DDS needs before parameters."""
    return any(value == "true" for value in _network_values(words))


def _network_values(words: list[str]) -> Iterator[str]:
    for word, value in itertools.pairwise(words):
        if word in ("-p", "--param"):
            name, _, text = value.partition(":=")
            if name.rpartition(":")[2] == "network":
                yield text.strip().lower()
        elif word == "--params-file":
            try:
                root = read_yaml(value, "parameter file")
            except InputError:
                continue  # rclpy says what is wrong with it
            for section in root.values.values():
                parameters = section.get("ros__parameters") if isinstance(section, dict) else None
                if isinstance(parameters, dict):
                    yield str(parameters.get("network", "")).lower()


def _keep_large_blocks() -> None:
    """Let malloc serve image-sized blocks from the heap and keep them."""
    library = ctypes.CDLL(None)
    if not hasattr(library, "mallopt"):  # not glibc: nothing to set
        return
    library.mallopt(_M_MMAP_THRESHOLD, 32 << 20)
    library.mallopt(_M_TRIM_THRESHOLD, 1 << 30)
    library.mallopt(_M_TOP_PAD, 16 << 20)
