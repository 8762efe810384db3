"""The workspace: built by colcon, its numerical kernels (package omm_kernels) with it."""

import hashlib
import os
from pathlib import Path

from setup.pythons import ON_ROS
from setup.steps import call
from setup.variables import build_environment, write_environment

ROOT = Path(__file__).resolve().parents[1]
WORKSPACE = ROOT / "ros2_ws" / "src"


def workspace_state() -> str:
    """Return a text that changes with every built source: names, sizes, times of the files."""
    digest = hashlib.sha256()
    for folder, names, files in os.walk(WORKSPACE):
        names[:] = sorted(
            n for n in names if n not in ("__pycache__", "test", "build", "install", "log")
        )
        for file in sorted(files):
            status = os.stat(os.path.join(folder, file))
            digest.update(f"{folder}/{file} {status.st_size} {status.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def build(home: Path, log: Path) -> None:
    """Build the packages with colcon."""
    bases = [str(WORKSPACE)]
    if not ON_ROS:
        bases.append(str(ROOT / "ros2_ws" / "only_without_ros" / "tf2_msgs"))
    colcon = [
        str(home / "venv" / "bin" / "python"),
        *([] if ON_ROS else ["-I"]),
        "-m",
        "colcon",
        "--log-base",
        str(home / "log"),
        "build",
    ]
    folders = [
        "--build-base",
        str(home / "build"),
        "--install-base",
        str(home / "install"),
        "--merge-install",
    ]
    arguments = [*colcon, *folders, "--base-paths", *bases]
    total = sum(1 for base in bases for _ in Path(base).rglob("package.xml"))

    command = [*arguments, "--cmake-args", "-DBUILD_TESTING=OFF"]
    call(command, log, build_environment(home), "Workspace built", r"^Finished", total)
    write_environment(home)
