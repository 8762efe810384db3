"""The workspace: built by colcon, its numerical kernels compiled ahead."""

import hashlib
import os
import subprocess
from pathlib import Path

from setup.pythons import ON_ROS
from setup.steps import call, say, write_whole
from setup.variables import build_environment, environment_of, write_environment

ROOT = Path(__file__).resolve().parents[1]
WORKSPACE = ROOT / "ros2_ws" / "src"


def workspace_state() -> str:
    """Changes with every source that is built: names, sizes and times of the files."""
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
    bases = [str(WORKSPACE)]
    if not ON_ROS:
        bases.append(str(ROOT / "ros2_ws" / "only_without_ros" / "tf2_msgs"))
    colcon = [
        str(home / "venv" / "bin" / "python"),
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

    def packages(*selection: str) -> None:
        command = [*arguments, *selection, "--cmake-args", "-DBUILD_TESTING=OFF"]
        call(command, log, build_environment(home), "Workspace built", r"^Finished", total)
        write_environment(home)

    kernels = home / "kernels.done"
    if kernels.is_file() and kernels.read_text() == kernel_state():
        packages()
        return
    # The kernels are compiled while the packages that hold none are built.
    packages("--packages-select", *WITH_KERNELS)
    compiling = start_kernels(home, log)
    try:
        packages("--packages-skip", *WITH_KERNELS)
        end_kernels(compiling, log)
    finally:
        for process in compiling.values():
            process.kill()
    write_whole(kernels, kernel_state())


def kernel_state() -> str:
    """Changes with every source that is compiled."""
    digest = hashlib.sha256()
    for file in sorted(WORKSPACE.glob("omm_*/omm_*/**/*.py")):
        content = file.read_bytes()
        if b"numba" in content:
            digest.update(content)
    return digest.hexdigest()


WITH_KERNELS = ("omm_core", "omm_simulation")
KERNELS = {  # the longest first
    "finding targets": ("omm_core.warm_up", "detection"),
    "solving": ("omm_core.warm_up", "estimation"),
    "rendering": ("omm_simulation.warm_up",),
}


def start_kernels(home: Path, log: Path) -> "dict[str, subprocess.Popen[bytes]]":
    """Compile the numerical kernels now, so that no measurement waits for it."""
    # A kernel that took in another one is not made anew by itself when only that one changes.
    for folder in (home / "install", WORKSPACE):
        for stale in folder.rglob("*.nb[ic]"):
            stale.unlink()
    python = str(home / "venv" / "bin" / "python")
    with open(log, "a") as file:
        return {
            what: subprocess.Popen(
                [python, "-m", *module],
                env=environment_of(home),
                stdout=file,
                stderr=subprocess.STDOUT,
            )
            for what, module in KERNELS.items()
        }


def end_kernels(compiling: "dict[str, subprocess.Popen[bytes]]", log: Path) -> None:
    say("Numerical kernels …", end="", again=True)
    failed = [what for what, process in compiling.items() if process.wait()]
    if failed:
        words = "could not be compiled ahead: the first measurement will wait for that"
        say(f"kernels for {' and '.join(failed)} {words} (why: {log})", again=True)
