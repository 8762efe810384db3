"""Paths and types that the tests of the suite as a whole use."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared" / "data"

Omm = Callable[..., "subprocess.CompletedProcess[str]"]

SMALL = ROOT / "test" / "data"


def shared_data(name: str) -> Path:
    """A folder of recorded data: the large ones where they are, else the small ones that we carry.

    Where neither is there, the test is skipped, or the whole file where it asks on import.
    """
    for folder in (SHARED / name, SMALL / name):
        if folder.is_dir():
            return folder
    pytest.skip(f"needs ../shared/data/{name}, which is not here", allow_module_level=True)
