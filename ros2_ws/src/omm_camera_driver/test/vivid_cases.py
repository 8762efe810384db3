"""The V4L2 driver against the kernel's vivid; run by `kernel_vm.py`, in its virtual machine."""

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from omm_camera_driver.driver import Camera, CameraSettings, DeviceLost, Frame, Trigger
from omm_camera_driver.drivers.v4l2.controls import Controls
from omm_camera_driver.drivers.v4l2.devices import devices, find
from omm_camera_driver.drivers.v4l2.driver import V4l2Driver
from omm_camera_driver.worker import CameraWorker
from omm_core.errors import DeviceError, InputError

# vivid's controls: no text over the picture.
PLAIN = {"osd_text_mode": "2", "timestamp_source": "1"}
# It makes up the end of a frame before that is over; the start of the exposure is a real time.
AT_START = {"timestamp_source": "1"}
WHITE, BLACK = "6", "5"


@pytest.fixture
def driver() -> Iterator[V4l2Driver]:
    driver = V4l2Driver()
    yield driver
    driver.close()


def patient(driver: V4l2Driver) -> Frame:
    for _ in range(100):
        frame = driver.next_frame(0.2)
        if frame is not None:
            return frame
    raise AssertionError("no frame")


def settled(driver: V4l2Driver) -> Frame:
    """A frame that was begun after the controls were set."""
    now_ns = time.time_ns()
    for _ in range(100):
        frame = patient(driver)
        if frame.exposure_mid_ns > now_ns + frame.stamp_uncertainty_ns:
            return patient(driver)
    raise AssertionError("no later frame")


def test_the_device_is_found_by_path_and_by_name() -> None:
    (found,) = [d for d in devices() if not d.problem]
    assert found.driver == "vivid"
    assert find("") == find(found.path) == find(found.card) == find(found.bus)
    with pytest.raises(DeviceError, match="/dev/video77"):
        find("/dev/video77")


@pytest.mark.parametrize("pixel_format", ["GREY", "Y16", "YUYV"])
def test_images_show_what_the_camera_was_told_to(driver: V4l2Driver, pixel_format: str) -> None:
    camera = driver.open(CameraSettings(pixel_format=pixel_format, controls=PLAIN))
    assert camera.granted["pixel_format"] == pixel_format
    driver.start()
    controls = Controls(driver._fd)
    greys = {}
    names = [n for n in controls.found if n == "test_pattern"]
    assert names
    for pattern in (WHITE, BLACK):
        controls.set_named("test_pattern", int(pattern))
        frame = settled(driver)
        assert frame.complete
        greys[pattern] = float(np.median(frame.image))
        assert np.ptp(frame.image) <= 0.02 * np.iinfo(frame.image.dtype).max
    full = np.iinfo(np.uint16 if pixel_format == "Y16" else np.uint8).max
    assert greys[WHITE] > 0.9 * full
    assert greys[BLACK] < 0.1 * full


def test_the_paper_s_image_size_is_granted(driver: V4l2Driver) -> None:
    camera = driver.open(CameraSettings(pixel_format="GREY", width_px=2592, height_px=1944))
    assert camera.granted["size_px"] == "2592x1944"
    driver.start()
    assert settled(driver).image.shape == (1944, 2592)


def test_a_size_that_the_device_lacks_is_refused_with_the_nearest(driver: V4l2Driver) -> None:
    with pytest.raises(InputError, match="the nearest is"):
        driver.open(CameraSettings(pixel_format="GREY", width_px=99_999, height_px=7))


def test_a_format_that_the_device_lacks_is_refused_with_those_it_has(driver: V4l2Driver) -> None:
    with pytest.raises(InputError, match=r"GREY.*got MJPG"):
        driver.open(CameraSettings(pixel_format="MJPG"))


def test_stamps_are_intervals_apart_as_granted_and_not_in_the_future(driver: V4l2Driver) -> None:
    camera = driver.open(
        CameraSettings(
            pixel_format="GREY", frame_rate_hz=15.0, width_px=640, height_px=480, controls=AT_START
        )
    )
    rate_hz = float(str(camera.granted["frame_rate_hz"]))
    driver.start()
    settled(driver)
    frames = []
    for _ in range(12):
        frame = patient(driver)
        late_ns = time.time_ns() - frame.exposure_mid_ns
        assert 0 < late_ns < 2_000_000_000
        frames.append((frame.exposure_mid_ns, frame.sequence))
    stamps, sequence = np.diff(np.array(frames), axis=0).T
    np.testing.assert_allclose(np.median(stamps / sequence), 1e9 / rate_hz, rtol=0.05)


def test_controls_are_set_by_name_and_checked(driver: V4l2Driver) -> None:
    driver.open(CameraSettings(pixel_format="GREY", controls={"brightness": "33"}, gain=77.0))
    controls = Controls(driver._fd)
    assert controls.get("brightness") == 33
    assert controls.get("gain") == 77
    assert driver.set("gain", 55.0) == 55.0
    with pytest.raises(InputError, match="from 0 to 255"):
        driver.set("gain", 1000.0)
    with pytest.raises(InputError, match="brightness"):
        controls.set_named("no_such", 1)
    with pytest.raises(InputError, match="exposure_us to be left unset"):
        driver.set("exposure_us", 1000.0)


def test_dropped_buffers_are_gaps_in_the_sequence(driver: V4l2Driver) -> None:
    driver.open(
        CameraSettings(
            pixel_format="GREY", width_px=640, height_px=480,
            controls={"percentage_of_dropped_buffers": "40"},
        )
    )  # fmt: skip
    driver.start()
    sequence = [patient(driver).sequence for _ in range(25)]
    Controls(driver._fd).set_named("percentage_of_dropped_buffers", 0)
    assert np.diff(sequence).max() > 1


def test_damaged_buffers_are_not_whole(driver: V4l2Driver) -> None:
    driver.open(CameraSettings(pixel_format="GREY", width_px=640, height_px=480))
    driver.start()
    settled(driver)
    Controls(driver._fd).set_named("inject_v4l2_buf_flag_error", 1)
    assert not all(patient(driver).complete for _ in range(12))


def test_unplugging_is_a_loss(driver: V4l2Driver) -> None:
    driver.open(CameraSettings(pixel_format="GREY", width_px=640, height_px=480))
    driver.start()
    settled(driver)
    Controls(driver._fd).set_named("disconnect", 1)
    with pytest.raises(DeviceLost):
        _look_on(driver)


def _look_on(driver: V4l2Driver) -> None:
    for _ in range(50):
        driver.next_frame(0.1)
        driver.check()


class _Listener:
    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.cameras: list[Camera] = []
        self.problems: list[str] = []
        self.news = threading.Condition()

    def on_frame(self, frame: Frame) -> None:
        self._add(self.frames, frame)

    def on_connected(self, camera: Camera) -> None:
        self._add(self.cameras, camera)

    def on_problem(self, problem: str) -> None:
        self._add(self.problems, problem)

    def _add(self, to: list, what: object) -> None:
        with self.news:
            to.append(what)
            self.news.notify_all()


def test_the_worker_reconnects_and_a_trigger_gets_a_later_image() -> None:
    listener = _Listener()
    made: list[V4l2Driver] = []

    def make() -> V4l2Driver:
        made.append(V4l2Driver())
        return made[-1]

    settings = CameraSettings(
        pixel_format="GREY", width_px=640, height_px=480, trigger=Trigger.SOFTWARE,
        controls=AT_START,
    )  # fmt: skip
    worker = CameraWorker(make, settings, listener, trigger_timeout_s=10.0)
    worker.start()
    for connection in (1, 2, 3):
        with listener.news:
            listener.news.wait_for(lambda n=connection: len(listener.cameras) == n, 20.0)
        asked_ns = time.time_ns()
        stamp_ns = worker.request_image().result(timeout=20.0)
        frame = listener.frames[-1]
        assert stamp_ns == frame.exposure_mid_ns
        assert stamp_ns + frame.stamp_uncertainty_ns >= asked_ns
        assert len(listener.frames) == connection  # nothing that was not asked for
        Controls(made[-1]._fd).set_named("disconnect", 1)
        returned_s = time.monotonic()
    with listener.news:
        assert listener.news.wait_for(lambda: len(listener.cameras) == 4, 20.0)
    print(f"after unplugging: streaming again after {time.monotonic() - returned_s:.2f} s")
    assert worker.stop(5.0)
