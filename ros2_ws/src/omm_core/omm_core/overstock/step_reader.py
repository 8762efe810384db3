"""The optional reader for STEP, installed when it is first needed."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path
from typing import Any

from omm_core.errors import InputError

MODULE = "cascadio"


def step_reader(root: Path | None) -> Any:
    """Return the module; ``root`` holds requirements/step.lock, which pins it.

    Raises
    ------
    InputError
        Where it is not there and cannot be installed.
    """
    try:
        return importlib.import_module(MODULE)
    except ImportError:
        lock = (root or Path()) / "requirements" / "step.lock"
    if not lock.is_file():
        raise InputError(
            f"Reading STEP needs the module {MODULE}, and requirements/step.lock is not there to"
            f" install it from. Give the CAD as STL, or install {MODULE}."
        )
    _install(lock)
    importlib.invalidate_caches()
    try:
        return importlib.import_module(MODULE)
    except ImportError as error:
        raise InputError(
            f"The reader for STEP was installed, but does not load ({error}). Give the CAD as STL."
        ) from None


def _install(lock: Path) -> None:
    """Install with pip, whose lines are the progress: its own bar needs a terminal or a new pip."""
    print("omm: installing the reader for STEP (once, 28 MB) …", file=sys.stderr, flush=True)
    command = [sys.executable, "-I", "-m", "pip", "install", "--no-deps", "--require-hashes"]
    command += ["--progress-bar", "off", "--disable-pip-version-check", "-r", str(lock)]
    last = "pip failed"
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as pip:
        for line in pip.stdout or ():
            if line.strip():
                last = line.strip()
                print(f"  {last}", file=sys.stderr, flush=True)
    if pip.returncode != 0:
        raise InputError(f"The reader for STEP cannot be installed ({last}). Give the CAD as STL.")
