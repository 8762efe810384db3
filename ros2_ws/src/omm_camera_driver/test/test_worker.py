"""The worker says what state it is in, whatever a driver does, and never dies unseen."""

import threading
import time

import pytest

from omm_camera_driver.driver import CameraSettings
from omm_camera_driver.worker import CameraWorker, State
from omm_core.errors import DeviceError

WAIT_S = 10.0


class _Listener:
    def __init__(self) -> None:
        self.problems: list[str] = []
        self.told = threading.Event()

    def on_frame(self, frame: object) -> None:
        raise AssertionError("there is no camera")

    def on_connected(self, camera: object) -> None:
        raise AssertionError("there is no camera")

    def on_problem(self, problem: str) -> None:
        self.problems.append(problem)
        self.told.set()


@pytest.mark.parametrize(
    "failure", [DeviceError("libaravis is missing."), OSError("no such library")]
)
def test_a_driver_that_cannot_even_be_made_is_told_with_its_reason(failure: Exception) -> None:
    def make() -> None:
        raise failure

    listener = _Listener()
    worker = CameraWorker(make, CameraSettings(), listener)  # type: ignore[arg-type]
    worker.start()
    try:
        assert listener.told.wait(WAIT_S)
        status = worker.status()
        assert status.state is State.ABSENT
        assert str(failure) in status.problem
        assert str(failure) in str(worker.request_image().exception())
        assert len(listener.problems) == 1  # once, though it goes on trying
    finally:
        assert worker.stop(WAIT_S)


def test_a_worker_that_is_stopped_says_inactive_and_takes_no_image() -> None:
    def make() -> None:
        raise DeviceError("nothing there")

    worker = CameraWorker(make, CameraSettings(), _Listener())  # type: ignore[arg-type]
    assert worker.status().state is State.INACTIVE
    worker.start()
    deadline_s = time.monotonic() + WAIT_S
    while not worker.status().problem and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert worker.stop(WAIT_S)
    status = worker.status()
    assert (status.state, status.problem, status.rate_hz) == (State.INACTIVE, "", 0.0)
    assert "not active" in str(worker.request_image().exception())
