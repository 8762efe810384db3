"""The whole set-up, step by step; what is done is not done again."""

import fcntl
import os
from pathlib import Path

from setup.libraries import install, make_environment, mend_wheels
from setup.pythons import LIBRARIES, ON_ROS, base_python
from setup.steps import SetupError, say, step
from setup.variables import environment_of
from setup.workspace import build, workspace_state


def _of_another_user(home: Path, error: OSError) -> dict[str, str]:
    """Take an environment that somebody else has set up, and that cannot be written to."""
    workspace, python = home / "workspace.done", home / "venv" / "bin" / "python"
    if not os.access(python, os.X_OK) or not os.access(workspace, os.R_OK):
        raise SetupError(
            f"{home} cannot be written to ({error.strerror}), and is not set up (or not for you)."
            " Have its owner run ./omm setup, with a Python that everybody may run, or work in a"
            " copy of your own."
        )
    if workspace.read_text() != workspace_state():
        raise SetupError(
            f"{home} is older than its sources and cannot be written to ({error.strerror})."
            " Have its owner run ./omm setup, or work in a copy of your own."
        )
    return environment_of(home)


def set_up(home: Path) -> dict[str, str]:
    """Bring the environment up to date (milliseconds when it is); return its variables."""
    try:
        home.mkdir(parents=True, exist_ok=True)
        lock_file = open(home / "lock", "w")  # noqa: SIM115 - closed below
    except OSError as error:
        return _of_another_user(home, error)
    with lock_file as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another omm is setting up; waiting for it")
            fcntl.flock(lock, fcntl.LOCK_EX)
        step(
            home,
            "environment",
            base_python(),
            lambda log: make_environment(home, log),
            "Python environment",
        )
        install(home, LIBRARIES, dict(os.environ))
        if not ON_ROS:
            step(
                home,
                "mended",
                "1",
                lambda log: mend_wheels(home),
                "ROS 2 wheels mended for this Python",
            )
        step(home, "workspace", workspace_state(), lambda log: build(home, log), "Workspace built")
    return environment_of(home)
