"""The Python environment and what is installed in it, from locked lists with hashes."""

import hashlib
import os
import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from setup.pythons import ON_ROS, base_python
from setup.steps import SetupError, call, step, write_whole

ROOT = Path(__file__).resolve().parents[1]


def make_environment(home: Path, log: Path) -> None:
    """Make the virtual environment, after checking for what only the system can bring."""
    for tool in ("c++", "cmake"):
        if shutil.which(tool) is None:
            raise SetupError(
                f"expected a C++ compiler and cmake to build the messages, found no {tool}. "
                "On Debian and Ubuntu: sudo apt install g++ cmake make"
            )
    options = ["--system-site-packages"] if ON_ROS else []
    call(
        [base_python(), "-I", "-m", "venv", "--clear", *options, str(home / "venv")],
        log,
        dict(os.environ),
    )


def install(home: Path, name: str, environment: dict[str, str]) -> None:
    """Install what a locked list names, to the letter; with ROS: what the system lacks."""
    python = str(home / "venv" / "bin" / "python")
    # Compiling all modules ahead would double the time; the few that run are compiled then.
    quick = ["--no-compile", "--progress-bar=off", "--disable-pip-version-check"]
    pip = [python, "-I", "-m", "pip", "install", *quick]
    if ON_ROS:
        listed = ROOT / "requirements" / ("test.in" if name == "test" else "ros-jazzy.txt")
    else:
        listed = ROOT / "requirements" / f"{name}.lock"
    if not listed.is_file():
        raise SetupError(f"OMM_LIBRARIES names {name}; there is no {listed}.")
    title = "Tools for the tests" if name == "test" else "ROS 2 and Python libraries"
    total = len(re.findall(r"^[a-z]", listed.read_text(), re.MULTILINE))

    def work(log: Path) -> None:
        # What an interrupted run left half-installed has no RECORD; pip would take it as whole.
        for half in (home / "venv" / "lib").glob("python3.*/site-packages/*.dist-info"):
            if not (half / "RECORD").is_file():
                shutil.rmtree(half)
        if ON_ROS and name != "test":
            wanted = ["--constraint", str(listed), *missing_on_ros(python, listed, environment)]
        elif ON_ROS:
            wanted = ["--constraint", str(listed.with_name("ros-jazzy.txt")), "-r", str(listed)]
        else:
            install_locked(home, listed, pip, log, environment, title, total)
            return
        if wanted[2:]:
            call([*pip, *wanted], log, environment, title, PIP_PROGRESS, total)

    step(home, name, hashlib.sha256(listed.read_bytes()).hexdigest(), work, title)


# Not -I: where ROS is installed, PYTHONPATH says where. The current folder does not count.
SAFE_PATH = "import sys; sys.path[:] = [p for p in sys.path if p.startswith('/')]; "
PIP_PROGRESS = r"^(?:Collecting|  Using|Requirement)"


def install_locked(
    home: Path, listed: Path, pip: list, log: Path, environment: dict, title: str, total: int
) -> None:
    """Install a list that is complete and needs no order: half by half, side by side."""
    entry = re.compile(r"^[a-zA-Z].*?(?=^[a-zA-Z]|\Z)", re.MULTILINE | re.DOTALL)
    entries = entry.findall(listed.read_text())
    commands = []
    for half in (0, 1):
        part = home / f"{listed.stem}.{half}.lock"
        write_whole(part, "".join(entries[half::2]))
        commands.append([*pip, "--no-deps", "--require-hashes", "-r", str(part)])
    with ThreadPoolExecutor() as pool:
        silent = pool.submit(call, commands[1], log, environment)
        call(commands[0], log, environment, title, PIP_PROGRESS, total // 2)
        silent.result()


def missing_on_ros(python: str, listed: Path, environment: dict[str, str]) -> list[str]:
    """Return the requirements whose module neither ROS nor the system nor an earlier run has."""
    pairs = re.findall(r"^(\S+) +# (\S+)$", listed.read_text(), re.MULTILINE)
    code = (
        "import sys, importlib.util as u; print(*[m for m in sys.argv[1:] if not u.find_spec(m)])"
    )
    found = subprocess.run(
        [python, "-c", SAFE_PATH + code, *(module for _, module in pairs)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    missing = found.stdout.split()
    return [requirement for requirement, module in pairs if module in missing]


def mend_wheels(home: Path) -> None:
    """Point the wheels' cmake files to this Python; they name their build machine's."""
    code = (
        "import sysconfig, numpy; print(sysconfig.get_path('include')); print(numpy.get_include())"
    )
    python = str(home / "venv" / "bin" / "python")
    output = subprocess.run(
        [python, "-I", "-c", code], capture_output=True, text=True, check=True
    ).stdout
    include, numpy_include = output.splitlines()[-2:]
    for file in (home / "venv" / "share").rglob("*.cmake"):
        text = file.read_text()
        mended = re.sub(
            r"/opt/python/cp\d+-cp\d+/lib/python[\d.]+/site-packages/numpy/_core/include",
            numpy_include,
            text,
        )
        mended = re.sub(r"/opt/python/cp\d+-cp\d+/include/python[\d.]+", include, mended)
        if mended != text:
            file.write_text(mended)
