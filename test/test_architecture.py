"""The layers of docs/architecture.md hold: read from the imports of every source file."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[1] / "ros2_ws" / "src"
CORE = {"omm_core"}
ALLOWED = {
    "omm_core": CORE,
    "omm_simulation": CORE | {"omm_simulation"},
    "omm_kernels": CORE | {"omm_simulation", "omm_kernels"},
    "omm_recording": CORE | {"omm_recording"},
    "omm_runs": CORE | {"omm_recording", "omm_runs"},
    "omm_report": CORE | {"omm_recording", "omm_runs", "omm_report"},
    "omm_ros": CORE | {"omm_ros", "omm_interfaces"},
    "omm_camera_driver": CORE
    | {"omm_camera_driver", "omm_ros", "omm_interfaces", "omm_simulation"},
    "omm_cnc_bridge": CORE | {"omm_cnc_bridge", "omm_ros", "omm_interfaces", "omm_simulation"},
    "omm_estimator": CORE | {"omm_estimator", "omm_ros", "omm_interfaces"},
    "omm_recorder": CORE | {"omm_recorder", "omm_recording", "omm_ros", "omm_interfaces"},
    "omm_operator": CORE
    | {"omm_operator", "omm_report", "omm_runs", "omm_recording", "omm_ros", "omm_interfaces"},
}
ROS_FREE = ("omm_core", "omm_simulation", "omm_kernels", "omm_recording", "omm_runs", "omm_report")

MOST_LINES, MOST_ARGUMENTS = 60, 10


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Yield every function of every package with its name, ``package/file.py:function``."""
    for package in sorted(path.name for path in SOURCES.iterdir()):
        for file in sorted((SOURCES / package / package).rglob("*.py")):
            where = file.relative_to(SOURCES / package)
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                    yield f"{where}:{node.name}", node


def imported_packages(package: str) -> set[str]:
    names: set[str] = set()
    for file in (SOURCES / package / package).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_a_package_imports_only_the_packages_below_it(package: str) -> None:
    ours = {name for name in imported_packages(package) if name.startswith("omm_")}
    assert ours <= ALLOWED[package]


@pytest.mark.parametrize("package", ROS_FREE)
def test_core_and_simulation_do_not_know_of_ros(package: str) -> None:
    names = imported_packages(package)
    messages = {name for name in names if name.endswith(("_msgs", "_srvs", "_interfaces"))}
    assert "rclpy" not in names
    assert not messages


def test_every_package_declares_what_it_imports_of_ours() -> None:
    for package in ALLOWED:
        manifest = (SOURCES / package / "package.xml").read_text()
        for name in imported_packages(package):
            if name.startswith("omm_") and name != package:
                assert f">{name}</" in manifest, f"{package} imports {name}"


def test_rooms_of_the_core_import_only_what_stands_below_them() -> None:
    linted = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-cache"],
        cwd=SOURCES.parents[1],
        env={**os.environ, "PYTHONPATH": str(SOURCES / "omm_core")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert linted.returncode == 0, linted.stdout


def test_no_function_is_longer_than_a_screen() -> None:
    long = {
        name
        for name, node in functions()
        if (node.end_lineno or node.lineno) - node.lineno + 1 > MOST_LINES
    }
    assert not long


def test_no_function_has_more_arguments_by_position_than_one_can_tell_apart() -> None:
    many = {
        name
        for name, node in functions()
        if len(node.args.posonlyargs) + len(node.args.args) > MOST_ARGUMENTS
    }
    assert not many
