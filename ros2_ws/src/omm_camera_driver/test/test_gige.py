"""The GigE driver against a camera that speaks the real protocol on loopback."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from omm_camera_driver.driver import CameraSettings, Frame, Trigger
from omm_camera_driver.drivers.genicam.driver import GenicamDriver
from omm_camera_driver.drivers.gige import gvcp
from omm_camera_driver.drivers.gige.finding import find
from omm_camera_driver.drivers.gige.link import GigeLink, GigeOptions
from omm_camera_driver.drivers.gige.simulator import GigeSimulator
from omm_core.errors import DeviceError, InputError

WIDTH, HEIGHT = 2592, 1944
EXPOSURE_NS = 5_000_000
_DIFFERENT = 64  # images, before they repeat


class Shown:
    """What the camera saw, exposure by exposure."""

    def __init__(self) -> None:
        self.images: list[tuple[int, int, NDArray[np.generic]]] = []
        shape = (HEIGHT + _DIFFERENT, WIDTH)
        wide = np.random.default_rng(5).integers(0, 2**16, shape, dtype=np.uint16)
        self._noise = {16: wide, 8: (wide >> 8).astype(np.uint8)}

    def fill(self, begin_ns: int, exposure_ns: int, bits: int) -> NDArray[np.generic]:
        row = len(self.images) % _DIFFERENT  # another part of the noise each time: costs nothing
        image = self._noise[bits][row : row + HEIGHT]
        self.images.append((begin_ns, exposure_ns, image))
        return image


@pytest.fixture(scope="module")
def shown() -> Shown:
    return Shown()


@pytest.fixture(scope="module")
def camera(gige_address: str, shown: Shown) -> Iterator[GigeSimulator]:
    simulator = GigeSimulator(shown.fill, WIDTH, HEIGHT, address=gige_address)
    yield simulator
    simulator.close()


@pytest.fixture
def open_driver(
    camera: GigeSimulator, shown: Shown
) -> Iterator[Callable[[CameraSettings], GenicamDriver]]:
    drivers: list[GenicamDriver] = []

    def open_with(settings: CameraSettings) -> GenicamDriver:
        driver = GenicamDriver(GigeLink(GigeOptions(device="OMM-SIM-1")))
        drivers.append(driver)
        # A camera keeps what the last one set: begin from the same.
        whole = settings if settings.width_px else replace(settings, offset_x_px=0, offset_y_px=0)
        driver.open(replace(whole, pixel_format=settings.pixel_format or "Mono8"))
        driver.start()
        shown.images.clear()
        return driver

    yield open_with
    for driver in drivers:
        driver.close()


Open = Callable[[CameraSettings], GenicamDriver]


def take(driver: GenicamDriver) -> Frame:
    """A whole frame; one that lost packets on a busy machine is taken again."""
    for _ in range(3):
        driver.flush()
        driver.trigger()
        for _ in range(50):
            frame = driver.next_frame(0.1)
            if frame is not None and frame.complete:
                return frame
            if frame is not None:
                break
    raise AssertionError("no whole frame")


@pytest.mark.parametrize(
    ("pixel_format", "kept_bits"), [("Mono8", None), ("Mono16", 0xFFFF), ("Mono12Packed", 0xFFF0)]
)
def test_images_arrive_pixel_by_pixel(
    open_driver: Open, shown: Shown, pixel_format: str, kept_bits: int | None
) -> None:
    driver = open_driver(CameraSettings(trigger=Trigger.SOFTWARE, pixel_format=pixel_format))
    for _ in range(5):
        frame = take(driver)
        _, _, image = shown.images[-1]
        expected = image if kept_bits is None else image & np.uint16(kept_bits)
        assert frame.image.dtype == expected.dtype
        np.testing.assert_array_equal(frame.image, expected)


def test_a_region_of_interest_is_that_part_of_the_sensor(open_driver: Open, shown: Shown) -> None:
    region = {"offset_x_px": 16, "offset_y_px": 8, "width_px": 640, "height_px": 480}
    driver = open_driver(CameraSettings(trigger=Trigger.SOFTWARE, **region))
    frame = take(driver)
    np.testing.assert_array_equal(frame.image, shown.images[-1][2][8:488, 16:656])


def test_the_stamp_is_the_middle_of_the_exposure_within_its_uncertainty(
    open_driver: Open, shown: Shown
) -> None:
    driver = open_driver(CameraSettings(trigger=Trigger.SOFTWARE, exposure_us=EXPOSURE_NS / 1000))
    for _ in range(5):
        frame = take(driver)
        begin_ns, exposure_ns, _ = shown.images[-1]
        assert exposure_ns == EXPOSURE_NS
        error_ns = frame.exposure_mid_ns - (begin_ns + exposure_ns // 2)
        assert abs(error_ns) <= frame.stamp_uncertainty_ns
        assert frame.stamp_uncertainty_ns < 50_000_000
    assert driver.health()["clock"] == "latched"


def test_continuous_images_come_at_the_rate_asked_for(open_driver: Open) -> None:
    driver = open_driver(CameraSettings(frame_rate_hz=20.0))
    frames = [f for f in (driver.next_frame(1.0) for _ in range(12)) if f is not None]
    stamps = [frame.exposure_mid_ns for frame in frames if frame.complete]
    assert np.median(np.diff(stamps)) == pytest.approx(50e6, rel=0.05)


def test_settings_are_granted_and_read_back(camera: GigeSimulator) -> None:
    driver = GenicamDriver(GigeLink(GigeOptions()))
    settings = CameraSettings(
        exposure_us=1234.0, gain=7.0, black_level=12.0, frame_rate_hz=10.0,
        trigger=Trigger.HARDWARE, trigger_line="Line0", strobe_line="Line1",
        controls={"TestRegister": "77"},
    )  # fmt: skip
    try:
        granted = driver.open(settings).granted
        assert granted["exposure_us"] == 1234.0
        assert granted["gain"] == 7.0
        assert granted["black_level"] == 12.0
        assert granted["frame_rate_hz"] == pytest.approx(10.0)
        assert camera.register(0x1F0) == 77
        trigger_mode_on, trigger_source_line0 = camera.register(0x300), camera.register(0x304)
        assert (trigger_mode_on, trigger_source_line0) == (1, 0)
        line, mode, source = (camera.register(a) for a in (0x410, 0x414, 0x418))
        assert (line, mode, source) == (1, 1, 1)  # Line1, Output, ExposureActive
        assert driver.set("gain", 2.0) == 2.0
        assert driver.health()["temperature_degc"] == 41.0
    finally:
        driver.close()


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        (CameraSettings(exposure_us=1e9), "from 10 to 1e+07 µs"),
        (CameraSettings(gain=99.0), "from 0 to 10"),
        (CameraSettings(black_level=300.0), "from 0 to 255"),
        (CameraSettings(width_px=9999), "from 1 to 2592"),
        (CameraSettings(pixel_format="Foo"), "Mono8"),
        (CameraSettings(controls={"Nope": "1"}), "Nope"),
        (CameraSettings(trigger=Trigger.HARDWARE), "trigger_line"),
    ],
)
def test_a_setting_out_of_range_is_refused_with_the_range(
    camera: GigeSimulator, settings: CameraSettings, named: str
) -> None:
    driver = GenicamDriver(GigeLink(GigeOptions()))
    try:
        with pytest.raises(InputError) as refused:
            driver.open(settings)
    finally:
        driver.close()
    assert named in str(refused.value)


@pytest.mark.parametrize("name", ["OMM-SIM-1", "127.0.0.1", "simulated GigE camera", ""])
def test_a_camera_is_found_by_serial_address_or_model(camera: GigeSimulator, name: str) -> None:
    assert find(name).serial == "OMM-SIM-1"


def test_a_camera_that_is_not_there_is_named_with_what_is(camera: GigeSimulator) -> None:
    with pytest.raises(DeviceError, match="called ABC, found omm simulated GigE camera OMM-SIM-1"):
        find("ABC")


def test_a_camera_that_another_program_holds_is_told_so(open_driver: Open) -> None:
    open_driver(CameraSettings())
    other = GenicamDriver(GigeLink(GigeOptions()))
    with pytest.raises(DeviceError, match="another program holds it"):
        other.open(CameraSettings())
    other.close()
    time.sleep(0.6)  # an answer "held" is believed for half a second


def test_flushing_throws_away_what_came_before(open_driver: Open, shown: Shown) -> None:
    driver = open_driver(CameraSettings(trigger=Trigger.SOFTWARE))
    for _ in range(4):  # images that nobody fetches
        driver.trigger()
        time.sleep(0.1)
    frame = take(driver)
    np.testing.assert_array_equal(frame.image, shown.images[-1][2])
    assert driver.next_frame(0.2) is None


def test_packets_that_are_lost_make_an_image_incomplete(
    camera: GigeSimulator, open_driver: Open
) -> None:
    driver = open_driver(CameraSettings(frame_rate_hz=20.0))
    camera.lose_packets(0.05)
    try:
        frames = [driver.next_frame(1.0) for _ in range(20)]
        whole = [frame.complete for frame in frames if frame is not None]
        assert not all(whole)
        assert driver.health()["packets_missing"] > 0
    finally:
        camera.lose_packets(0.0)


def test_two_cameras_on_one_address_are_refused(camera: GigeSimulator, shown: Shown) -> None:
    with pytest.raises(DeviceError, match="a camera is there already"):
        GigeSimulator(shown.fill, WIDTH, HEIGHT)


def test_discovery_lists_the_camera(camera: GigeSimulator) -> None:
    (found,) = gvcp.discover()
    assert (found.vendor, found.model) == ("omm", "simulated GigE camera")
    assert found.why_unreachable() == ""
