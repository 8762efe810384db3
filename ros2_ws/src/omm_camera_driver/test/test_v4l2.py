"""V4L2 without a device: layouts, pixels, stamps (with one: `vivid_cases.py`)."""

import ctypes
import struct

import numpy as np
import pytest

from omm_camera_driver.driver import CameraSettings
from omm_camera_driver.drivers.v4l2 import devices, sizes, videodev
from omm_camera_driver.drivers.v4l2.controls import Controls, FoundControl, control_name
from omm_camera_driver.drivers.v4l2.driver import exposure_middle, mono_image
from omm_core.errors import DeviceError


# Request numbers as a C compiler makes them of <linux/videodev2.h> on 64-bit Linux: they hold the
# size of the structure, so that a wrong layout cannot go unnoticed.
@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("QUERYCAP", 0x80685600), ("ENUM_FMT", 0xC0405602), ("G_FMT", 0xC0D05604),
        ("S_FMT", 0xC0D05605), ("REQBUFS", 0xC0145608), ("QUERYBUF", 0xC0585609),
        ("QBUF", 0xC058560F), ("DQBUF", 0xC0585611), ("STREAMON", 0x40045612),
        ("STREAMOFF", 0x40045613), ("G_PARM", 0xC0CC5615), ("S_PARM", 0xC0CC5616),
        ("G_CTRL", 0xC008561B), ("S_CTRL", 0xC008561C), ("QUERYCTRL", 0xC0445624),
        ("ENUM_FRAMESIZES", 0xC02C564A),
    ],
)  # fmt: skip
def test_requests_are_the_kernel_s(name: str, number: int) -> None:
    assert getattr(videodev, name) == number


def test_a_buffer_s_fields_lie_where_the_kernel_puts_them() -> None:
    buffer = videodev.Buffer
    offsets = (buffer.timestamp.offset, buffer.sequence.offset, buffer.m.offset)
    assert offsets == (24, 56, 64)
    raw = bytearray(ctypes.sizeof(buffer))
    struct.pack_into("<qq", raw, 24, 12, 345678)
    assert buffer.from_buffer(raw).timestamp_ns == 12_345_678_000


def pix(name: str, width: int, height: int, row_bytes: int = 0) -> videodev.PixelFormat:
    return videodev.PixelFormat(
        width=width, height=height, pixelformat=videodev.fourcc(name), bytesperline=row_bytes
    )


def test_padded_rows_are_cut() -> None:
    rows = np.arange(4 * 8, dtype=np.uint8).reshape(4, 8)
    image = mono_image(rows.reshape(-1), pix("GREY", 6, 4, 8))
    assert image is not None
    np.testing.assert_array_equal(image, rows[:, :6])


def test_yuyv_is_its_brightness() -> None:
    data = np.arange(2 * 6 * 4, dtype=np.uint8)
    image = mono_image(data, pix("YUYV", 6, 4))
    assert image is not None
    np.testing.assert_array_equal(image.reshape(-1), data[::2])


def test_y16_is_little_endian() -> None:
    data = np.array([1, 2, 3, 4], np.uint8)
    image = mono_image(data, pix("Y16", 2, 1))
    assert image is not None
    np.testing.assert_array_equal(image, [[0x0201, 0x0403]])


def test_jpeg_is_decoded_and_a_cut_one_is_not_whole() -> None:
    cv2 = pytest.importorskip("cv2")
    grey = np.tile(np.linspace(0, 255, 64, dtype=np.uint8), (48, 1))
    data = cv2.imencode(".jpg", grey)[1].reshape(-1)
    image = mono_image(data, pix("MJPG", 64, 48))
    assert image is not None
    assert np.abs(image.astype(int) - grey).max() < 8
    assert mono_image(data[: len(data) // 2], pix("MJPG", 64, 48)) is None


def test_data_that_are_cut_short_are_not_whole() -> None:
    assert mono_image(np.zeros(11, np.uint8), pix("GREY", 4, 3)) is None


INTERVAL_NS, EXPOSURE_NS = 100_000_000, 8_000_000


def test_a_stamp_of_the_start_is_half_an_exposure_early() -> None:
    middle_ns, off_ns = exposure_middle(
        10**9, at_start=True, exposure_ns=EXPOSURE_NS, readout_ns=0, interval_ns=INTERVAL_NS
    )
    assert middle_ns == 10**9 + EXPOSURE_NS // 2
    assert off_ns == 1_000_000


def test_a_stamp_of_the_end_is_a_readout_and_half_an_exposure_late() -> None:
    middle_ns, off_ns = exposure_middle(
        10**9, at_start=False, exposure_ns=EXPOSURE_NS, readout_ns=30_000_000,
        interval_ns=INTERVAL_NS,
    )  # fmt: skip
    assert middle_ns == 10**9 - 30_000_000 - EXPOSURE_NS // 2
    assert off_ns == 1_000_000


@pytest.mark.parametrize("readout_ns", [0, 10_000_000, 99_000_000])
def test_an_unknown_readout_is_within_the_uncertainty(readout_ns: int) -> None:
    end_ns = 10**9
    middle_ns, off_ns = exposure_middle(
        end_ns, at_start=False, exposure_ns=EXPOSURE_NS, readout_ns=0, interval_ns=INTERVAL_NS
    )
    true_middle_ns = end_ns - readout_ns - EXPOSURE_NS // 2
    assert abs(middle_ns - true_middle_ns) <= off_ns


def test_control_names_are_those_of_v4l2_ctl() -> None:
    assert control_name("Exposure Time, Absolute") == "exposure_time_absolute"
    assert control_name("Percentage of Dropped Buffers") == "percentage_of_dropped_buffers"


# --- what a former user left, and what the user did not say ---


def found(path: str, bus: str, problem: str = "") -> devices.FoundDevice:
    return devices.FoundDevice(path=path, driver="uvc", card="Cam", bus=bus, problem=problem)


def test_of_several_devices_none_is_taken_at_random(monkeypatch: pytest.MonkeyPatch) -> None:
    there = [found("/dev/video0", "usb-1"), found("/dev/video2", "usb-2")]
    monkeypatch.setattr(devices, "devices", lambda: there)
    with pytest.raises(DeviceError, match=r"one video device, found /dev/video0 .*/dev/video2"):
        devices.find("")
    assert devices.find("/dev/video2") == there[1]
    assert devices.find("usb-1") == there[0]
    monkeypatch.setattr(devices, "devices", lambda: [there[0], found("/dev/video1", "usb-1", "x")])
    assert devices.find("") == there[0]


def test_a_size_that_a_former_user_left_is_told() -> None:
    single = videodev.FrameSize(type=videodev.SINGLE_SIZE)
    single.sizes.min_width, single.sizes.max_width = 2592, 1944
    span = videodev.FrameSize(type=3)
    span.sizes.max_width, span.sizes.max_height = 640, 480
    assert (single.largest, span.largest) == ((2592, 1944), (640, 480))
    assert sizes.largest_size([span, single]) == 2592 * 1944
    assert sizes.largest_size([]) == 0


@pytest.mark.parametrize(
    ("settings", "told"), [(CameraSettings(), 1), (CameraSettings(width_px=640), 0)]
)
def test_a_small_size_is_told_unless_it_was_asked_for(
    monkeypatch: pytest.MonkeyPatch, settings: CameraSettings, told: int
) -> None:
    def call(_fd: int, _request: int, size: videodev.FrameSize) -> videodev.FrameSize:
        if size.index:
            raise DeviceError("that was the last one")
        size.type = videodev.SINGLE_SIZE
        size.sizes.min_width, size.sizes.max_width = 1920, 1080
        return size

    monkeypatch.setattr(videodev, "call", call)
    assert len(sizes.smaller_than_it_can(0, pix("GREY", 640, 480), settings)) == told
    assert sizes.smaller_than_it_can(0, pix("GREY", 1920, 1080), CameraSettings()) == ()


def test_a_mirroring_that_a_former_user_left_is_taken_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    values = {1: 1, 2: 0}

    def call(_fd: int, request: int, control: videodev.Control) -> videodev.Control:
        if request == videodev.S_CTRL:
            values[control.id] = control.value
        control.value = values[control.id]
        return control

    monkeypatch.setattr(videodev, "call", call)
    controls = Controls.__new__(Controls)
    controls._fd = 0
    controls.found = {
        name: FoundControl(id=number, name=name, type=2, minimum=0, maximum=1)
        for name, number in (("horizontal_flip", 1), ("vertical_flip", 2))
    }
    assert controls.take_back(keep={"horizontal_flip": "1"}) == ()
    (note,) = controls.take_back(keep={})
    assert "horizontal_flip was 1" in note
    assert values == {1: 0, 2: 0}
