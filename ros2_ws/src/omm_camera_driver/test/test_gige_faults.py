"""A camera that goes away and comes back: nothing wrong is published, nothing is left behind."""

import os
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from omm_camera_driver.driver import CameraSettings, Trigger
from omm_camera_driver.drivers.genicam.driver import GenicamDriver
from omm_camera_driver.drivers.gige.link import GigeLink, GigeOptions
from omm_camera_driver.worker import CameraWorker
from omm_camera_driver.worker_status import WorkerState
from omm_core.errors import DeviceError

sys.path.insert(0, str(Path(__file__).parent))
from camera_peers import ADDRESS, CameraProcess, Recorder
from gige_camera_process import begin_of, pattern

SETTINGS = CameraSettings(exposure_us=2000.0, gain=5.0, frame_rate_hz=50.0)
TRIGGERED = CameraSettings(exposure_us=2000.0, gain=5.0, trigger=Trigger.SOFTWARE)
RECONNECTION_S = 2.0
CYCLES = int(os.environ.get("OMM_CAMERA_CYCLES", "50"))


def driver_for(device: str) -> GenicamDriver:
    return GenicamDriver(GigeLink(GigeOptions(device=device)))


def worker_for(recorder: Recorder, settings: CameraSettings = SETTINGS) -> CameraWorker:
    return CameraWorker(lambda: driver_for(ADDRESS), settings, recorder)


def threads_and_files() -> tuple[int, int]:
    """Threads of this process, those of C libraries included, and open files."""
    return len(os.listdir("/proc/self/task")), len(os.listdir("/proc/self/fd"))


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def assert_right(recorder: Recorder) -> None:
    """Every published image is whole, and stamped with the middle of its exposure."""
    for frame, image in recorder.frames:
        begin_ns = begin_of(image)
        np.testing.assert_array_equal(image, pattern(begin_ns))
        error_ns = frame.exposure_mid_ns - frame.exposure_ns // 2 - begin_ns
        assert abs(error_ns) <= frame.stamp_uncertainty_ns + 1000


@pytest.mark.timeout(900)
def test_losses_one_after_another_leave_nothing_behind(
    camera_process: CameraProcess, recorder: Recorder
) -> None:
    camera_process.start()
    worker = worker_for(recorder)
    worker.start()
    assert recorder.wait_for(lambda r: len(r.frames) > 5)
    recoveries = []
    before = None
    for cycle in range(CYCLES):
        camera_process.kill()
        assert recorder.wait_for(lambda r, n=cycle: len(r.problems) > n), worker.status()
        returned_s = camera_process.start()
        assert recorder.wait_for(lambda r, n=cycle: len(r.cameras) > n + 1), worker.status()
        recoveries.append(time.monotonic() - returned_s)
        shown = len(recorder.frames)
        assert recorder.wait_for(lambda r, n=shown: len(r.frames) > n + 2)
        if cycle == 1:  # after what is made once
            before = (*threads_and_files(), resident_mb())
        if cycle % 10 == 0:
            assert_right(recorder)
        recorder.frames.clear()
    after = (*threads_and_files(), resident_mb())
    assert worker.stop(timeout_s=5.0)
    print(f"seconds to recovery: median {np.median(recoveries):.2f}, most {max(recoveries):.2f}")
    print(f"threads, files, MB: {before} before, {after} after")
    assert before is not None
    assert after[:2] == before[:2]
    assert after[2] < before[2] + 20  # ten buffers of one connection are 3 MB
    assert all(c.granted == recorder.cameras[0].granted for c in recorder.cameras)
    assert np.median(recoveries) < RECONNECTION_S


def test_a_cable_pulled_and_plugged_in_again(
    camera_process: CameraProcess, recorder: Recorder
) -> None:
    camera_process.start()
    worker = worker_for(recorder)
    worker.start()
    for out_s in (0.3, 4.0, 9.0):
        shown = len(recorder.frames)
        assert recorder.wait_for(lambda r, n=shown: len(r.frames) > n + 5)
        camera_process.pull()
        time.sleep(out_s)
        returned_s = camera_process.plug_in()
        shown = len(recorder.frames)
        assert recorder.wait_for(lambda r, n=shown: len(r.frames) > n + 2), worker.status()
        print(f"out for {out_s} s: images again after {time.monotonic() - returned_s:.2f} s")
    assert worker.stop(timeout_s=5.0)
    assert_right(recorder)


def test_stopping_is_quick_while_the_camera_is_away(
    camera_process: CameraProcess, recorder: Recorder
) -> None:
    camera_process.start()
    worker = worker_for(recorder)
    worker.start()
    assert recorder.wait_for(lambda r: len(r.frames) > 2)
    camera_process.pull()
    assert recorder.wait_for(lambda r: bool(r.problems))
    begin_s = time.monotonic()
    worker.stop(timeout_s=1.0)
    assert time.monotonic() - begin_s < 1.5
    camera_process.plug_in()
    # What still closes the connection would disturb the next test.
    for thread in threading.enumerate():
        if thread.name.startswith("camera"):
            thread.join(15.0)


def test_a_trigger_while_the_camera_is_away_is_answered_with_the_reason(
    camera_process: CameraProcess, recorder: Recorder
) -> None:
    worker = worker_for(recorder, TRIGGERED)
    worker.start()
    assert recorder.wait_for(lambda r: bool(r.problems))
    with pytest.raises(DeviceError, match="found none"):
        worker.request_image().result(timeout=1.0)
    camera_process.start()
    assert recorder.wait_for(lambda r: bool(r.cameras))
    stamp_ns = worker.request_image().result(timeout=5.0)
    assert stamp_ns == recorder.frames[-1][0].exposure_mid_ns
    assert worker.stop(timeout_s=5.0)


def test_a_triggered_image_was_exposed_after_the_trigger_however_long_nobody_asked(
    camera_process: CameraProcess, recorder: Recorder
) -> None:
    camera_process.start()
    worker = worker_for(recorder, TRIGGERED)
    worker.start()
    assert recorder.wait_for(lambda r: bool(r.cameras))
    for pause_s in (0.0, 0.0, 3.0, 0.0):
        time.sleep(pause_s)
        asked_ns = time.time_ns()
        stamp_ns = worker.request_image().result(timeout=5.0)
        frame = recorder.frames[-1][0]
        begin_ns = stamp_ns - frame.exposure_ns // 2
        assert begin_ns + frame.stamp_uncertainty_ns >= asked_ns
        assert begin_ns < time.time_ns()
    assert worker.stop(timeout_s=5.0)
    assert len(recorder.frames) == 4
    assert_right(recorder)


def test_no_incomplete_image_is_published_when_packets_are_lost(
    camera_process: CameraProcess, recorder: Recorder
) -> None:
    camera_process.start(lost=0.1)
    worker = worker_for(recorder)
    worker.start()
    assert recorder.wait_for(lambda r: len(r.frames) > 20)
    assert worker.stop(timeout_s=5.0)
    assert worker.status().incomplete > 0
    assert_right(recorder)


def test_a_camera_held_by_another_program_is_taken_when_it_is_let_go(
    camera_process: CameraProcess, recorder: Recorder
) -> None:
    camera_process.start()
    other = driver_for(ADDRESS)
    other.open(SETTINGS)
    worker = worker_for(recorder)
    worker.start()
    assert recorder.wait_for(lambda r: any("another program holds it" in p for p in r.problems))
    assert worker.status().state is WorkerState.ABSENT
    other.close()
    assert recorder.wait_for(lambda r: len(r.frames) > 2)
    assert worker.stop(timeout_s=5.0)


def test_a_wrong_address_is_told_with_what_is_there(
    camera_process: CameraProcess, recorder: Recorder
) -> None:
    camera_process.start()
    worker = CameraWorker(lambda: driver_for("127.0.0.77"), SETTINGS, recorder)
    worker.start()
    assert recorder.wait_for(lambda r: bool(r.problems))
    assert worker.stop(timeout_s=5.0)
    assert "127.0.0.77, found omm simulated GigE camera" in recorder.problems[0]
    assert len(recorder.problems) == 1  # said once
