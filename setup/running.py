"""Start a program in the environment. None of them looks for modules in the current folder."""

import os
import shutil
import sys
from pathlib import Path


def run_executable(home: Path, words: list[str], environment: dict[str, str]) -> int:
    """Replace this process by an executable of a package; 2 where there is none."""
    if len(words) < 2:
        print("omm: expected: ./omm run PACKAGE EXECUTABLE [--ros-args …]", file=sys.stderr)
        return 2
    package, executable = words[:2]
    folder = home / "install" / "lib" / package
    if not (folder / executable).is_file():
        there = ", ".join(
            sorted(f"{p.parent.name} {p.name}" for p in folder.parent.glob("omm_*/*_node"))
        )
        print(
            f"omm: no executable {executable} in package {package}. There are: {there}.",
            file=sys.stderr,
        )
        return 2
    if executable.endswith("_node") and (trouble := _missing_middleware(environment)):
        print(f"omm: {trouble}", file=sys.stderr)
        return 2
    # For what it starts with -m or -c: the current folder is no place to look for modules.
    safe = {**environment, "PYTHONSAFEPATH": "1"}
    os.execve(folder / executable, [executable, *words[2:]], safe)


def _missing_middleware(environment: dict[str, str]) -> str:
    """Return what is wrong with RMW_IMPLEMENTATION; empty where nothing is.

    A node cannot say so itself: its first import of ROS 2 ends the process.
    """
    name = environment.get("RMW_IMPLEMENTATION", "")
    prefixes = environment.get("AMENT_PREFIX_PATH", "").split(":")
    index = "share/ament_index/resource_index/rmw_typesupport"
    there = {file.name for prefix in prefixes for file in Path(prefix, index).glob("rmw_*")}
    installed = sorted(there - {"rmw_implementation"})
    if not name or not installed or name in installed:
        return ""
    return (
        f"RMW_IMPLEMENTATION: expected {' or '.join(installed)} (installed here), got {name}. "
        "Unset it, or install that one."
    )


def run_tool(words: list[str], environment: dict[str, str]) -> int:
    """Replace this process by any command of the environment; 2 where there is none."""
    found = shutil.which(words[0], path=environment["PATH"]) if words else None
    if found is None:
        told = " ".join(words) or "nothing"
        print(f"omm: expected a command to run, got {told}.", file=sys.stderr)
        return 2
    os.execve(found, words, environment)
