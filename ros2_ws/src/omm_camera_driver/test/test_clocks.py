"""A system clock that is set, or a computer that slept, makes no wrong stamp and is told."""

import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omm_camera_driver.clocks import Clocks, WallClock, read_clocks
from omm_camera_driver.driver import Camera, CameraSettings, Frame, FrameLost, Trigger
from omm_camera_driver.drivers.simulated.cell_view import CellView, cell_view
from omm_camera_driver.drivers.simulated.driver import SimulatedDriver
from omm_camera_driver.drivers.simulated.true_poses import TruePoses
from omm_camera_driver.worker import CameraWorker
from omm_core.geometry import RigidTransform

S = 1_000_000_000
HOUR = 3600 * S


class SetClock:
    """The computer's clocks, with a wall clock that the test sets."""

    def __init__(self) -> None:
        self.set_ns = 0
        self.slept_ns = 0

    def __call__(self) -> Clocks:
        now_ns = time.monotonic_ns()
        return Clocks(
            monotonic_ns=now_ns,
            system_ns=now_ns + 1_700_000_000 * S + self.set_ns,
            since_boot_ns=now_ns + self.slept_ns,
        )

    def wall_ns(self) -> int:
        return self().system_ns


def at(monotonic_s: float, offset_s: float, *, slept_s: float = 0.0, unsure_ns: int = 0) -> Clocks:
    monotonic_ns = round(monotonic_s * S)
    return Clocks(
        monotonic_ns=monotonic_ns,
        system_ns=monotonic_ns + round(offset_s * S),
        since_boot_ns=monotonic_ns + round(slept_s * S),
        half_width_ns=unsure_ns,
    )


@given(st.floats(-1e6, 1e6).filter(lambda s: abs(s) > 0.002))
def test_a_step_is_noticed_once_and_stamps_follow_it(step_s: float) -> None:
    looks = iter([at(1.0, 5e8), at(2.0, 5e8), at(3.0, 5e8 + step_s), at(4.0, 5e8 + step_s)])
    wall = WallClock(lambda: next(looks))
    assert wall.look() is None
    step = wall.look()
    assert step is not None
    assert step.step_ns == pytest.approx(step_s * S, abs=1000)
    assert wall.system_ns(10 * S) == pytest.approx((10 + 5e8 + step_s) * S, abs=1000)
    assert wall.monotonic_of(wall.system_ns(10 * S)) == 10 * S
    assert wall.look() is None


def test_a_sleep_is_told_as_a_sleep_and_not_as_a_clock_that_was_set() -> None:
    looks = iter([at(1.0, 5e8), at(2.0, 5e8 + 40.0, slept_s=40.0)])
    wall = WallClock(lambda: next(looks))
    told = str(wall.look())
    assert "slept for 40.0 s" in told
    assert "was set" not in told


def test_a_busy_computer_is_no_step() -> None:
    """Between reading one clock and the other, the thread may have had to wait."""
    looks = iter([at(1.0, 5e8), at(2.0, 5e8 + 0.02, unsure_ns=25_000_000), at(3.0, 5e8)])
    wall = WallClock(lambda: next(looks))
    assert wall.look() is None
    assert wall.look() is None


def test_the_real_clocks_are_read_close_together() -> None:
    before_ns = time.time_ns()
    look = read_clocks()
    assert before_ns <= look.system_ns <= time.time_ns()
    assert look.half_width_ns < S
    assert WallClock().look() is None


class _Listener:
    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.problems: list[str] = []
        self.news = threading.Condition()

    def on_frame(self, frame: Frame) -> None:
        with self.news:
            self.frames.append(frame)
            self.news.notify_all()

    def on_connected(self, camera: Camera) -> None:
        """Good."""

    def on_problem(self, problem: str) -> None:
        self.problems.append(problem)

    def wait_for(self, count: int) -> bool:
        with self.news:
            return self.news.wait_for(lambda: len(self.frames) >= count, 10.0)


class _Stamping:
    """A camera that stamps by the wall clock, which is set while it works."""

    def __init__(self, clock: SetClock, settings: dict[int, int]) -> None:
        self.clock = clock
        self.set_before = settings  # number of the image: what the clock is set by before it comes
        self.taken = 0
        self.triggers: list[int] = []

    def open(self, settings: CameraSettings) -> Camera:
        return Camera(vendor="", model="", serial="1", address="", has_software_trigger=True)

    def start(self) -> None:
        """It stands ready."""

    def flush(self) -> None:
        self.triggers.clear()

    def trigger(self) -> None:
        self.triggers.append(self.clock.wall_ns())

    def next_frame(self, timeout_s: float) -> Frame | None:
        time.sleep(0.01)
        stamp_ns = self.triggers.pop(0) if self.triggers else self.clock.wall_ns()
        self.taken += 1
        self.clock.set_ns += self.set_before.get(self.taken, 0)
        return Frame(
            image=np.zeros((2, 2), np.uint8), exposure_mid_ns=stamp_ns, exposure_ns=0,
            stamp_uncertainty_ns=0, sequence=self.taken,
        )  # fmt: skip

    def check(self) -> None:
        """It is there."""

    def health(self) -> dict[str, object]:
        return {}

    def close(self) -> None:
        """Nothing is held."""


@pytest.mark.parametrize("step_ns", [-HOUR, HOUR])
def test_a_triggered_image_across_a_step_is_taken_again(step_ns: int) -> None:
    clock, listener = SetClock(), _Listener()
    camera = _Stamping(clock, {2: step_ns})
    settings = CameraSettings(trigger=Trigger.SOFTWARE)
    worker = CameraWorker(lambda: camera, settings, listener, wall=WallClock(clock))  # type: ignore[arg-type, return-value]
    worker.start()
    try:
        deadline_s = time.monotonic() + 10.0
        while worker.status().camera is None and time.monotonic() < deadline_s:
            time.sleep(0.01)
        for _ in range(3):
            asked_ns = clock.wall_ns()
            stamp_ns = worker.request_image().result(timeout=10.0)
            assert asked_ns - HOUR * (step_ns < 0) <= stamp_ns <= clock.wall_ns()
            assert abs(clock.wall_ns() - stamp_ns) < 10 * S  # by the clock as it is now
        assert camera.taken == 4
        assert worker.status().clock_steps == 1
        assert worker.status().stale == 0
        assert "clock was set" in worker.status().problem
        assert any(f"set by {step_ns / S:+.3f} s" in problem for problem in listener.problems)
    finally:
        worker.stop(10.0)


@pytest.mark.parametrize("step_ns", [-HOUR, HOUR])
def test_of_images_that_come_by_themselves_only_that_of_the_step_is_missing(step_ns: int) -> None:
    clock, listener = SetClock(), _Listener()
    camera = _Stamping(clock, {5: step_ns})
    worker = CameraWorker(lambda: camera, CameraSettings(), listener, wall=WallClock(clock))  # type: ignore[arg-type, return-value]
    worker.start()
    try:
        assert listener.wait_for(12)
        numbers = [frame.sequence for frame in listener.frames[:12]]
        assert numbers == [1, 2, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13]
        assert worker.status().missing == 0
    finally:
        worker.stop(10.0)


@pytest.fixture(scope="module")
def view() -> CellView:
    return cell_view("bench", 1)


@pytest.fixture
def standing() -> Iterator[tuple[SetClock, TruePoses]]:
    """A spindle that stands still, told every 5 ms by a clock that is set."""
    clock, poses, ended = SetClock(), TruePoses(), threading.Event()
    place = RigidTransform.from_euler_xyz_rad(0.0, 0.0, 0.0, (-130.0, 0.0, 600.0))

    def tell() -> None:
        while not ended.wait(0.005):
            poses.add(clock.wall_ns(), place)

    thread = threading.Thread(target=tell)
    thread.start()
    yield clock, poses
    ended.set()
    thread.join()


def test_the_simulated_camera_keeps_its_rate_when_the_clock_is_set_back(
    view: CellView, standing: tuple[SetClock, TruePoses]
) -> None:
    """By the wall clock, its next image would be due in an hour."""
    clock, poses = standing
    driver = SimulatedDriver(view, poses, WallClock(clock))
    driver.open(CameraSettings(frame_rate_hz=5.0))
    driver.start()
    assert _next(driver) is not None
    clock.set_ns = -HOUR
    frame = _next(driver)
    assert abs(clock.wall_ns() - frame.exposure_mid_ns) < 60 * S


def _next(driver: SimulatedDriver) -> Frame:
    """The next image; those whose exposure began before the first pose are lost."""
    for _ in range(50):
        try:
            frame = driver.next_frame(1.0)
        except FrameLost:
            continue
        if frame is not None:
            return frame
    raise AssertionError("no image comes")


def test_durations_are_of_the_monotonic_clock() -> None:
    """Where the wall clock is read otherwise than for a stamp, a step makes a wrong duration."""
    package = Path(__file__).parents[1] / "omm_camera_driver"
    reading = re.compile(r"\btime\.time(_ns)?\(\)")
    found = {
        path.relative_to(package).as_posix(): len(reading.findall(path.read_text()))
        for path in package.rglob("*.py")
    }
    assert {path: count for path, count in found.items() if count} == {
        "clocks.py": 1,
        "drivers/gige/simulator.py": 1,  # the simulated camera's own clock
        "drivers/v4l2/driver.py": 1,  # "before now", of a stamp of no known clock
    }
