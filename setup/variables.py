"""The variables of the environment: what building needs, and what running needs."""

import json
import os
import subprocess
from pathlib import Path

from setup.pythons import ON_ROS
from setup.steps import write_whole

ROOT = Path(__file__).resolve().parents[1]


def build_environment(home: Path) -> dict[str, str]:
    """Return the variables by which cmake and colcon find ROS.

    With wheels, the environment's root is the prefix.
    """
    venv = home / "venv"
    variables = dict(os.environ, PATH=f"{venv / 'bin'}:{os.environ['PATH']}", VIRTUAL_ENV=str(venv))
    variables.pop("PYTHONPATH" if not ON_ROS else "", None)
    if not ON_ROS:
        libraries = [
            str(venv / "lib"),
            *map(str, sorted(venv.glob("lib/python3.*/site-packages/ros_*.libs"))),
        ]
        variables |= {
            "AMENT_PREFIX_PATH": str(venv),
            "CMAKE_PREFIX_PATH": str(venv),
            "LD_LIBRARY_PATH": ":".join(libraries),
            "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",  # spares every Python start a second exec
            "ROS_DISTRO": "jazzy",
            "ROS_VERSION": "2",
            "ROS_PYTHON_VERSION": "3",
        }
    return variables


SHARED_VARIABLES = (
    "PATH",
    "PYTHONPATH",
    "LD_LIBRARY_PATH",
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
)


def write_environment(home: Path) -> None:
    """Source the workspace once and keep what that sets: sourcing costs half a second a start."""
    before = build_environment(home)
    before["PATH"] = f"{home / 'venv' / 'bin'}:@PATH@"
    shell = f"PATH=$PATH:/usr/bin:/bin; . '{home}/install/local_setup.sh' >/dev/null; env -0"
    output = subprocess.run(
        ["/bin/sh", "-c", shell], env=before, capture_output=True, check=True
    ).stdout.decode()
    after = dict(item.split("=", 1) for item in output.split("\0") if "=" in item)
    names = [
        *SHARED_VARIABLES,
        "VIRTUAL_ENV",
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
        "ROS_DISTRO",
        "ROS_VERSION",
    ]
    names.append("ROS_PYTHON_VERSION")
    kept = {name: after[name] for name in names if name in after}
    kept["PATH"] = kept["PATH"].replace(":@PATH@:/usr/bin:/bin", ":@PATH@")
    write_whole(home / "environment.json", json.dumps(kept, indent=1))


def environment_of(home: Path) -> dict[str, str]:
    """Return the variables of an environment that is set up, upon those of this process."""
    variables = json.loads((home / "environment.json").read_text())
    variables["PATH"] = variables["PATH"].replace("@PATH@", os.environ["PATH"])
    variables["OMM_ROOT"] = str(ROOT)
    environment = {**os.environ, **variables}
    # An empty entry is the current folder, whatever lies there.
    paths = environment.get("PYTHONPATH", "").split(":")
    environment["PYTHONPATH"] = ":".join(path for path in paths if os.path.isabs(path))
    return environment
