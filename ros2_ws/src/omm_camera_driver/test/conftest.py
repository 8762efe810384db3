"""Fixtures of the camera tests: the simulated GigE camera, alone on its address."""

import fcntl
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from omm_camera_driver.drivers.genicam import aravis

sys.path.insert(0, str(Path(__file__).parent))
from camera_peers import ADDRESS, CameraProcess, Recorder


@pytest.fixture(scope="session")
def gige_address() -> Iterator[str]:
    """The address of the simulated camera: one test run of this computer at a time has it."""
    try:
        aravis.load()
    except aravis.AravisMissing as missing:
        pytest.skip(str(missing))
    with open(Path(tempfile.gettempdir()) / "omm-simulated-gige-camera.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield ADDRESS


@pytest.fixture
def camera_process(gige_address: str) -> Iterator[CameraProcess]:
    """A simulated GigE camera that can be killed and pulled; off at first."""
    process = CameraProcess()
    yield process
    process.kill()


@pytest.fixture
def recorder() -> Recorder:
    """A listener of a worker."""
    return Recorder()
