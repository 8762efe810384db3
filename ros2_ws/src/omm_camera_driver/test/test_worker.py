"""The worker says what state it is in, whatever a driver does, and never dies unseen."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from omm_camera_driver import worker as worker_module
from omm_camera_driver.driver import Camera, CameraSettings, Frame, Trigger
from omm_camera_driver.parameters import Parameters, check_exposure
from omm_camera_driver.worker import CameraWorker
from omm_camera_driver.worker_status import WorkerState
from omm_core.errors import DeviceError, InputError

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
        assert status.state is WorkerState.ABSENT
        assert str(failure) in status.problem
        assert str(failure) in str(worker.request_image().exception())
        assert len(listener.problems) == 1  # once, though it goes on trying
    finally:
        assert worker.stop(WAIT_S)


def test_a_worker_that_is_stopped_says_inactive_and_takes_no_image() -> None:
    def make() -> None:
        raise DeviceError("nothing there")

    worker = CameraWorker(make, CameraSettings(), _Listener())  # type: ignore[arg-type]
    assert worker.status().state is WorkerState.INACTIVE
    worker.start()
    deadline_s = time.monotonic() + WAIT_S
    while not worker.status().problem and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert worker.stop(WAIT_S)
    status = worker.status()
    assert (status.state, status.problem, status.rate_hz) == (WorkerState.INACTIVE, "", 0.0)
    assert "not active" in str(worker.request_image().exception())


class _SilentDriver:
    """A camera that is there, and sends what it is told to."""

    def __init__(self, frames: list[Frame] | None = None) -> None:
        self.frames = frames or []

    def open(self, settings: CameraSettings) -> Camera:
        return Camera(
            vendor="", model="silent", serial="1", address="here", has_software_trigger=True
        )

    def start(self) -> None:
        """Nothing to start."""

    def next_frame(self, timeout_s: float) -> Frame | None:
        time.sleep(0.01)
        return self.frames.pop(0) if self.frames else None

    def trigger(self) -> None:
        """It does not care."""

    def flush(self) -> None:
        """Nothing waits."""

    def check(self) -> None:
        """It is always there."""

    def health(self) -> dict[str, object]:
        return {}

    def close(self) -> None:
        raise OSError("the handle is gone")


class _Calm(_Listener):
    def on_frame(self, frame: object) -> None:
        """Take it."""

    def on_connected(self, camera: object) -> None:
        """Good."""


def _until(condition: object) -> None:
    deadline_s = time.monotonic() + WAIT_S
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """A camera is called silent after 0.4 s here: the tests need not wait for longer."""
    monkeypatch.setattr(worker_module, "_SILENT_S", 0.4)


@pytest.fixture
def running() -> object:
    started: list[CameraWorker] = []

    def run(driver: _SilentDriver, trigger: Trigger, listener: _Listener) -> CameraWorker:
        settings = CameraSettings(trigger=trigger)
        worker = CameraWorker(lambda: driver, settings, listener, trigger_timeout_s=0.2)  # type: ignore[arg-type, return-value]
        worker.start()
        started.append(worker)
        _until(lambda: worker.status().state is WorkerState.STREAMING)
        return worker

    yield run
    for worker in started:
        worker.stop(WAIT_S)


def test_a_camera_that_runs_by_itself_and_sends_nothing_is_told(running) -> None:  # type: ignore[no-untyped-def]
    worker = running(_SilentDriver(), Trigger.CONTINUOUS, _Calm())
    assert worker.status().problem == ""
    _until(lambda: "no image has come" in worker.status().problem)


def test_a_trigger_without_an_image_is_told_until_one_comes(running) -> None:  # type: ignore[no-untyped-def]
    worker = running(_SilentDriver(), Trigger.SOFTWARE, _Calm())
    time.sleep(0.6)  # nobody asks, so nothing is wrong
    assert worker.status().problem == ""
    assert worker.request_image().exception(WAIT_S) is not None
    assert "Expected an image within 0.2 s" in worker.status().problem


def test_whatever_ends_the_thread_is_told_in_state_and_to_who_asks(running) -> None:  # type: ignore[no-untyped-def]
    class Breaks(_Calm):
        def on_problem(self, problem: str) -> None:
            super().on_problem(problem)
            if len(self.problems) == 1:
                raise RuntimeError("the publisher is gone")

    driver, listener = _SilentDriver(), Breaks()
    driver.check = lambda: (_ for _ in ()).throw(DeviceError("unplugged"))  # type: ignore[method-assign]
    worker = running(driver, Trigger.CONTINUOUS, listener)
    _until(lambda: "thread has ended" in worker.status().problem)
    assert worker.status().state is WorkerState.LOST
    assert "the publisher is gone" in worker.status().problem
    assert "thread has ended" in str(worker.request_image().exception(WAIT_S))
    assert any("thread has ended" in problem for problem in listener.problems)


def test_a_camera_that_cannot_be_closed_is_told(running) -> None:  # type: ignore[no-untyped-def]
    listener = _Calm()
    worker = running(_SilentDriver(), Trigger.SOFTWARE, listener)
    worker.stop(WAIT_S)
    assert any("could not be closed: the handle is gone" in p for p in listener.problems)


def _frame(sequence: int, grey: int) -> Frame:
    return Frame(
        image=np.full((8, 8), grey, np.uint8), exposure_mid_ns=time.time_ns(), exposure_ns=0,
        stamp_uncertainty_ns=0, sequence=sequence,
    )  # fmt: skip


def test_black_images_are_published_and_told_until_one_is_not(running) -> None:  # type: ignore[no-untyped-def]
    driver = _SilentDriver([_frame(1, 0)])
    worker = running(driver, Trigger.CONTINUOUS, _Calm())
    _until(lambda: "is black" in worker.status().problem)
    assert worker.status().published == 1
    driver.frames.append(_frame(2, 90))
    _until(lambda: worker.status().problem == "")


def test_a_camera_whose_own_rate_is_slow_is_not_called_silent(running) -> None:  # type: ignore[no-untyped-def]
    driver = _SilentDriver()
    open_ = driver.open
    driver.open = lambda settings: replace(open_(settings), granted={"frame_rate_hz": 0.1})  # type: ignore[method-assign]
    worker = running(driver, Trigger.CONTINUOUS, _Calm())
    time.sleep(0.6)
    assert worker.status().problem == ""


def test_an_exposure_longer_than_a_trigger_may_take_is_refused() -> None:
    with pytest.raises(InputError, match="trigger_timeout_s longer than the exposure of 5 s"):
        check_exposure(Parameters(trigger="software", exposure_us=5e6))
    check_exposure(Parameters(exposure_us=5e6))
    check_exposure(Parameters(trigger="software", exposure_us=5e6, trigger_timeout_s=6.0))
