"""Middleware settings without which 5 MB images get lost or slow.

Measured with rclpy on two cores: the default transports deliver 7-18 % of 20 images/s (best effort)
or need 40 ms each; with a shared-memory segment large enough for images, and a C library that keeps
large blocks instead of returning them to the kernel after every image, all arrive in 6 ms.
"""

import ctypes
import os
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from omm_ros.shared_memory import remove_leftovers

PROFILE_VARIABLES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")

# glibc, malloc.h
_M_TRIM_THRESHOLD = -1
_M_TOP_PAD = -2
_M_MMAP_THRESHOLD = -3


def prepare() -> None:
    """Apply the settings to this process; to be called before `rclpy.init`."""
    if not any(name in os.environ for name in PROFILE_VARIABLES):
        profile = str(Path(get_package_share_directory("omm_ros")) / "config" / "fastdds.xml")
        for name in PROFILE_VARIABLES:
            os.environ[name] = profile
    remove_leftovers()
    _keep_large_blocks()


def _keep_large_blocks() -> None:
    """Let malloc serve image-sized blocks from the heap and keep them."""
    library = ctypes.CDLL(None)
    if not hasattr(library, "mallopt"):  # not glibc: nothing to set
        return
    library.mallopt(_M_MMAP_THRESHOLD, 32 << 20)
    library.mallopt(_M_TRIM_THRESHOLD, 1 << 30)
    library.mallopt(_M_TOP_PAD, 16 << 20)
