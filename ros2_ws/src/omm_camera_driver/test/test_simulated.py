"""The simulated camera behind the worker, and what it makes of the spindle's true poses."""

import sys
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from omm_camera_driver.driver import CameraSettings, FrameLost, Trigger
from omm_camera_driver.drivers.simulated.cell_view import CellView, cell_view
from omm_camera_driver.drivers.simulated.driver import SimulatedDriver
from omm_camera_driver.drivers.simulated.true_poses import TruePoses, interpolate
from omm_camera_driver.worker import CameraWorker
from omm_core.errors import DeviceError, InputError
from omm_core.geometry import RigidTransform

sys.path.insert(0, str(Path(__file__).parent))
from camera_peers import Recorder

MS = 1_000_000


def at(x_mm: float, turn_rad: float = 0.0) -> RigidTransform:
    return RigidTransform.from_euler_xyz_rad(0.0, 0.0, turn_rad, (x_mm, 0.0, 600.0))


@pytest.fixture(scope="module")
def view() -> CellView:
    return cell_view("bench", 1)


@pytest.fixture
def standing() -> Iterator[TruePoses]:
    """A spindle that stands still, told every 5 ms."""
    poses, ended = TruePoses(), threading.Event()

    def tell() -> None:
        while not ended.wait(0.005):
            poses.add(time.time_ns(), at(-130.0))

    thread = threading.Thread(target=tell)
    thread.start()
    yield poses
    ended.set()
    thread.join()


def test_poses_are_interpolated_between_their_times() -> None:
    poses = TruePoses()
    poses.add(10 * MS, at(0.0, 0.0))
    poses.add(20 * MS, at(10.0, 0.02))
    pose_at = poses.during(12 * MS, 18 * MS, timeout_s=0.0)
    np.testing.assert_allclose(pose_at(15 * MS).translation_mm, [5.0, 0.0, 600.0])
    assert pose_at(15 * MS).euler_xyz_rad()[2] == pytest.approx(0.01, abs=1e-9)


def test_interpolation_takes_the_shorter_arc() -> None:
    halfway = interpolate(at(0.0, 3.1), at(0.0, -3.1), 0.5)
    assert abs(halfway.euler_xyz_rad()[2]) == pytest.approx(np.pi)


@pytest.mark.parametrize(
    ("stamps_ms", "told"),
    [
        ((), "got none"),
        ((0, 5), "before and after"),
        ((40, 45), "before and after"),
        ((0, 500), "got a gap of 500 ms"),
    ],
)
def test_an_exposure_without_poses_around_it_is_lost(stamps_ms: tuple[int, ...], told: str) -> None:
    poses = TruePoses()
    for stamp_ms in stamps_ms:
        poses.add(stamp_ms * MS, at(0.0))
    with pytest.raises(FrameLost, match=told):
        poses.during(10 * MS, 20 * MS, timeout_s=0.01)


def test_a_triggered_image_is_exposed_after_the_trigger(
    view: CellView, standing: TruePoses, recorder: Recorder
) -> None:
    settings = CameraSettings(trigger=Trigger.SOFTWARE, exposure_us=4000.0)
    worker = CameraWorker(lambda: SimulatedDriver(view, standing), settings, recorder)
    worker.start()
    assert recorder.wait_for(lambda r: bool(r.cameras), timeout_s=120.0)
    for count in (1, 2, 3):
        asked_ns = time.time_ns()
        stamp_ns = worker.request_image().result(timeout=10.0)
        assert asked_ns + 2 * MS <= stamp_ns < time.time_ns()
        assert len(recorder.frames) == count
    assert worker.stop()


def test_a_trigger_without_a_control_says_what_is_missing(
    view: CellView, recorder: Recorder
) -> None:
    settings = CameraSettings(trigger=Trigger.SOFTWARE)
    worker = CameraWorker(lambda: SimulatedDriver(view, TruePoses()), settings, recorder)
    worker.start()
    assert recorder.wait_for(lambda r: bool(r.cameras), timeout_s=120.0)
    with pytest.raises(DeviceError, match="simulation/true_spindle_pose"):
        worker.request_image().result(timeout=10.0)
    assert worker.status().unanswered_triggers == 1
    assert worker.stop()


def test_continuous_images_are_a_period_apart(
    view: CellView, standing: TruePoses, recorder: Recorder
) -> None:
    settings = CameraSettings(frame_rate_hz=4.0)
    worker = CameraWorker(lambda: SimulatedDriver(view, standing), settings, recorder)
    worker.start()
    assert recorder.wait_for(lambda r: len(r.frames) >= 4, timeout_s=120.0)
    assert worker.stop()
    frames = [frame for frame, _ in recorder.frames]
    for a, b in pairwise(frames):
        periods = b.sequence - a.sequence
        apart_ns = b.exposure_mid_ns - a.exposure_mid_ns
        assert apart_ns == pytest.approx(periods * 250 * MS, abs=20_000)


def test_exposure_changes_at_run_time_within_its_range(
    view: CellView, standing: TruePoses, recorder: Recorder
) -> None:
    settings = CameraSettings(trigger=Trigger.SOFTWARE)
    worker = CameraWorker(lambda: SimulatedDriver(view, standing), settings, recorder)
    worker.start()
    assert recorder.wait_for(lambda r: bool(r.cameras), timeout_s=120.0)
    assert worker.change("exposure_us", 2500.0).result(timeout=2.0) == 2500.0
    worker.request_image().result(timeout=10.0)
    assert recorder.frames[-1][0].exposure_ns == 2500_000
    with pytest.raises(InputError, match=r"from 10 to 1e\+06 µs"):
        worker.change("exposure_us", 1.0).result(timeout=2.0)
    assert worker.stop()
