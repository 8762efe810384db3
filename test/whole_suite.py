"""Paths and types that the tests of the suite as a whole use."""

import subprocess
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared" / "data"

Omm = Callable[..., "subprocess.CompletedProcess[str]"]
