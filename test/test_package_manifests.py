"""Each package.xml names what its package imports: rosdep installs from it on a machine PC."""

import ast
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from whole_suite import ROOT

PACKAGES = sorted(path.parent for path in (ROOT / "ros2_ws" / "src").glob("*/setup.py"))

# rosdep's key of a module that is no ROS package; None: rosdep has none, pip installs it.
ROSDEP_KEYS = {
    "GTC": None,
    "PIL": "python3-pil",
    "asyncua": None,
    "babel": "python3-babel",
    "cryptography": "python3-cryptography",
    "cv2": "python3-opencv",
    "fpdf": "python3-fpdf2-pip",
    "hypothesis": "python3-hypothesis",
    "lz4": None,
    "matplotlib": "python3-matplotlib",
    "mcap": None,
    "mpl_toolkits": "python3-matplotlib",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "pikepdf": None,
    "playwright": None,
    "pypdfium2": None,
    "pytest": "python3-pytest",
    "rich": "python3-rich",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "tornado": "python3-tornado",
    "trimesh": "python3-trimesh-pip",
    "yaml": "python3-yaml",
    "zstandard": None,
}
# Come with what is named here, and are not installed by themselves.
COME_ALONG = {"lz4": "mcap", "zstandard": "mcap"}
# Looked for when asked for, and told where missing: never a dependency.
OF_THE_SYSTEM = {"linuxcnc", "cascadio", "dask", "distributed"}


def imported(folder: Path) -> set[str]:
    """Top-level modules that the files of a folder import, wherever in them."""
    found: set[str] = set()
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                found.add(node.module.split(".")[0])
    return found - set(sys.stdlib_module_names) - OF_THE_SYSTEM


def needed(package: Path, folder: Path) -> set[str]:
    """Keys that package.xml must hold for a folder of the package."""
    beside = {file.stem for file in (ROOT / "ros2_ws" / "src").glob("*/test/*.py")}
    beside |= {file.stem for file in (ROOT / "test").glob("*.py")}
    modules = imported(folder) - {package.name} - beside
    keys = {ROSDEP_KEYS.get(module, module) for module in modules}
    return {key for key in keys if key is not None}


def named(package: Path, *kinds: str) -> set[str]:
    root = ET.parse(package / "package.xml").getroot()
    return {str(element.text) for kind in kinds for element in root.iter(kind)}


def _above(name: str) -> set[str]:
    """The packages that need a package, directly or through others."""
    direct = {p.name for p in PACKAGES if name in named(p, "exec_depend", "depend")}
    return direct.union(*(_above(other) for other in direct))


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.name)
def test_what_is_imported_is_named(package: Path) -> None:
    missing = needed(package, package / package.name) - named(package, "exec_depend", "depend")
    assert not missing


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.name)
def test_what_the_tests_import_is_named(package: Path) -> None:
    all_kinds = named(package, "exec_depend", "depend", "test_depend")
    # Naming a package that needs this one would be a circle for colcon.
    assert not needed(package, package / "test") - all_kinds - _above(package.name)


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.name)
def test_it_says_who_and_what(package: Path) -> None:
    root = ET.parse(package / "package.xml").getroot()
    for element in ("description", "maintainer", "license", "url"):
        assert root.findtext(element, "").strip(), element
    assert 'extras_require={"test": ["pytest"]}' in (package / "setup.py").read_text()


def test_what_rosdep_does_not_know_pip_installs() -> None:
    listed = (ROOT / "requirements" / "ros-jazzy.txt").read_text()
    by_pip = set(re.findall(r"# (\S+)$", listed, re.MULTILINE))
    modules = {module for package in PACKAGES for module in imported(package / package.name)}
    unknown = {m for m in modules if m in ROSDEP_KEYS and ROSDEP_KEYS[m] is None}
    assert not {COME_ALONG.get(module, module) for module in unknown} - by_pip
