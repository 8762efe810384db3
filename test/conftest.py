"""What the tests of the suite as a whole share: commands as a user gives them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from whole_suite import Omm, shared_data


@pytest.fixture
def omm(tmp_path: Path) -> Omm:
    """Run `./omm COMMAND …` (in the environment that these tests run in) in a folder of its own."""

    def run(*arguments: object, status: int = 0) -> "subprocess.CompletedProcess[str]":
        done = subprocess.run(
            [sys.executable, "-m", "omm_bringup.command_line", *map(str, arguments)],
            cwd=tmp_path,
            env={**os.environ, "COLUMNS": "100"},
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
        assert done.returncode == status, f"status {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done

    return run


@pytest.fixture(scope="session")
def bench_run() -> Path:
    """The run that an independent program made, with its truth beside it."""
    return shared_data("bench")
