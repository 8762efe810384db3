"""Compile the kernels of omm_core and omm_simulation into their cache, where they changed.

python -m omm_kernels.compiling
"""

import hashlib
import importlib.util
import subprocess
import sys
from pathlib import Path

PACKAGES = ("omm_core", "omm_simulation")
PROGRAMS = {  # the longest first
    "finding targets": ("omm_core.warm_up", "detection"),
    "solving": ("omm_core.warm_up", "estimation", "adjustment"),
    "rendering": ("omm_simulation.warm_up",),
}
_STATE = "kernels.sha256"


def main() -> int:
    """Compile what is not compiled yet; 1 where some of it failed."""
    folders = [_folder(package) for package in PACKAGES]
    state_file = folders[0] / "__pycache__" / _STATE
    state = _state(folders)
    if state_file.is_file() and state_file.read_text() == state:
        return 0
    # A kernel that took in another one is not made anew by itself when only that one changes.
    for folder in folders:
        for stale in folder.rglob("*.nb[ic]"):
            stale.unlink()
    started = {
        what: subprocess.Popen([sys.executable, "-m", *module]) for what, module in PROGRAMS.items()
    }
    failed = [what for what, process in started.items() if process.wait()]
    if failed:
        words = f"The kernels for {' and '.join(failed)} could not be compiled ahead"
        print(f"{words}: the first measurement will wait for that.", file=sys.stderr)
        return 1
    state_file.parent.mkdir(exist_ok=True)
    state_file.write_text(state)
    return 0


def _folder(package: str) -> Path:
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        raise SystemExit(f"Expected the package {package} to be installed; build it first.")
    return Path(spec.origin).parent


def _state(folders: list[Path]) -> str:
    """Return a text that changes with every compiled source, and with the compiler."""
    digest = hashlib.sha256(f"{sys.version} {_version('numba')} {_version('numpy')}".encode())
    for folder in folders:
        for file in sorted(folder.rglob("*.py")):
            content = file.read_bytes()
            if b"numba" in content:
                digest.update(content)
    return digest.hexdigest()


def _version(distribution: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(distribution)
    except PackageNotFoundError:
        return "unknown"


if __name__ == "__main__":
    sys.exit(main())
