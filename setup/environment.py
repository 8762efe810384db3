"""The whole set-up, step by step; what is done is not done again."""

import fcntl
import os
from pathlib import Path

from setup.libraries import install, make_environment, mend_wheels
from setup.pythons import LIBRARIES, ON_ROS, base_python
from setup.steps import say, step
from setup.variables import environment_of
from setup.workspace import build, workspace_state


def set_up(home: Path) -> dict[str, str]:
    """Bring the environment up to date and return its variables; costs milliseconds when it is."""
    home.mkdir(parents=True, exist_ok=True)
    with open(home / "lock", "w") as lock:
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
