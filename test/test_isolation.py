"""Whose modules run: never those of the current folder; and anybody's checkout can be used."""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from whole_suite import ROOT

sys.path.insert(0, str(ROOT))

from setup.variables import environment_of
from setup.workspace import workspace_state

NOBODY = 65534
TRAP = (
    "import pathlib; pathlib.Path(__file__).with_suffix('.sprung').touch(); raise SystemExit(7)\n"
)
MODULES = ("yaml", "numpy", "cv2", "omm_core", "runpy", "venv", "pip", "colcon", "multiprocessing")


@pytest.fixture
def trapped(tmp_path: Path) -> Path:
    """A folder with modules that tell when they are run."""
    for name in MODULES:
        (tmp_path / f"{name}.py").write_text(TRAP)
    return tmp_path


def sprung(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.sprung"))


def test_commands_do_not_run_modules_of_the_current_folder(trapped: Path) -> None:
    command = Path(get_package_prefix("omm_bringup")) / "lib" / "omm_bringup" / "omm"
    done = subprocess.run(
        [str(command), "info", "nowhere"],
        cwd=trapped, capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == 2
    assert "nowhere" in done.stderr
    assert sprung(trapped) == []


def test_empty_entries_of_the_path_for_modules_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "environment.json").write_text('{"PATH": "@PATH@"}')
    monkeypatch.setenv("PYTHONPATH", ":/opt/ros::relative:.")
    assert environment_of(tmp_path)["PYTHONPATH"] == "/opt/ros"


def test_what_commands_start_does_not_look_there_either(trapped: Path) -> None:
    """Processes that are started side by side, by multiprocessing and by -m."""
    code = (
        "import subprocess, sys; from concurrent.futures import ProcessPoolExecutor as P;"
        "from multiprocessing import get_context as c;"
        "print(P(1, mp_context=c('spawn')).submit(len, 'ab').result());"
        "subprocess.run([sys.executable, '-m', 'yaml'])"
    )
    run = (
        "import os, sys; sys.path.insert(0, sys.argv[1]); from setup.running import run_executable;"
    )
    run += (
        "from pathlib import Path; run_executable(Path(sys.argv[2]), ['p', 'e'], dict(os.environ))"
    )
    executable = trapped / "home" / "install" / "lib" / "p" / "e"
    executable.parent.mkdir(parents=True)
    executable.write_text(f"#!{sys.executable}\nif __name__ == '__main__':\n    {code}\n")
    executable.chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-I", "-c", run, str(ROOT), str(trapped / "home")],
        cwd=trapped, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    if sys.version_info < (3, 11):
        pytest.skip("Python 3.10 always looks in the current folder for -m and -c")
    assert done.stdout == "2\n", done.stderr
    assert sprung(trapped) == []


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that everybody may enter (pytest's own is private)."""
    if os.geteuid() != 0:
        pytest.skip("needs root, to become somebody else")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        yield folder


def set_up_by_nobody(home: Path) -> "subprocess.CompletedProcess[str]":
    python = shutil.which("python3", path="/usr/local/bin:/usr/bin:/bin")
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from pathlib import Path; from setup.environment import set_up\n"
        "from setup.steps import SetupError\n"
        "try: print(set_up(Path(sys.argv[2]))['OMM_ROOT'])\n"
        "except SetupError as error: sys.exit(f'omm: {error}')\n"
    )
    if python is None or not can_read(ROOT / "setup" / "steps.py"):
        pytest.skip("nobody else can read this checkout, or there is no Python for all")
    return subprocess.run(
        [python, "-I", "-B", "-c", code, str(ROOT), str(home)],
        cwd="/", user=NOBODY, group=NOBODY, extra_groups=[],
        capture_output=True, text=True, check=False, timeout=60,
        env={"PATH": os.environ["PATH"], "HOME": "/nonexistent"},
    )  # fmt: skip


def can_read(path: Path) -> bool:
    done = subprocess.run(["test", "-r", str(path)], user=NOBODY, group=NOBODY, check=False)
    return done.returncode == 0


def test_an_environment_that_another_user_has_set_up_is_used(open_folder: Path) -> None:
    python = open_folder / "venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.symlink_to("/bin/sh")
    (open_folder / "environment.json").write_text('{"PATH": "@PATH@"}')
    (open_folder / "workspace.done").write_text(workspace_state())
    for path in open_folder.rglob("*"):
        if not path.is_symlink():
            path.chmod(0o755)
    done = set_up_by_nobody(open_folder)
    assert done.stdout == f"{ROOT}\n", done.stderr
    (open_folder / "workspace.done").write_text("of yesterday")
    done = set_up_by_nobody(open_folder)
    assert done.returncode == 1
    assert "older than its sources" in done.stderr


def test_an_environment_that_nobody_set_up_is_told_in_one_sentence(open_folder: Path) -> None:
    done = set_up_by_nobody(open_folder / "wheels")
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "cannot be written to" in done.stderr
