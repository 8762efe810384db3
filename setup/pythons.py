"""Which Python and which libraries the environment is made of."""

import os
import re
import shutil
import subprocess
import sys

from setup.steps import SetupError

PYTHONS = ("3.10", "3.11", "3.12", "3.13")
ON_ROS = os.environ.get("ROS_DISTRO") == "jazzy" and "AMENT_PREFIX_PATH" in os.environ
LIBRARIES = os.environ.get("OMM_LIBRARIES", "omm")


def flavour() -> str:
    """Return the environment's name: installations that must not mix lie in separate folders."""
    version = ".".join(map(str, python_version(base_python())))
    return f"{'ros-jazzy' if ON_ROS else 'wheels'}-py{version}" + (
        "" if LIBRARIES == "omm" else f"-{LIBRARIES}"
    )


def base_python() -> str:
    """Return the interpreter to build on: OMM_PYTHON, ROS's, this one, or another there is."""
    if "OMM_PYTHON" in os.environ:
        chosen = shutil.which(os.environ["OMM_PYTHON"])
        if chosen is None:
            raise SetupError(f"OMM_PYTHON names {os.environ['OMM_PYTHON']}, which is not there.")
        return chosen
    if ON_ROS:
        return "/usr/bin/python3"
    if ".".join(map(str, sys.version_info[:2])) in PYTHONS:
        return os.path.join(sys.base_exec_prefix, "bin", f"python3.{sys.version_info[1]}")
    for version in reversed(PYTHONS):
        found = shutil.which(f"python{version}")
        if found:
            return found
    raise SetupError(
        f"expected Python {PYTHONS[0]} to {PYTHONS[-1]}, got {sys.version.split()[0]} only. "
        "Install one of them, or name it: OMM_PYTHON=/path/to/python3.12 ./omm …"
    )


def python_version(python: str) -> tuple[int, int]:
    """Return the version of an interpreter, (major, minor)."""
    match = re.search(r"python3\.(\d+)$", os.path.realpath(python))
    if match:
        return 3, int(match[1])
    code = "import sys; print(*sys.version_info[:2])"
    major, minor = subprocess.run(
        [python, "-I", "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    return int(major), int(minor)
