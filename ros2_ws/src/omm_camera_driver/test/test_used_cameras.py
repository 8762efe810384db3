"""GenICam cameras as others left them, and with what Aravis' own camera lacks: clock and limit.

Aravis' in-process camera stands in: its registers are written before the driver sees it.
"""

import time
from collections.abc import Callable, Iterator
from ctypes import byref, c_size_t, c_uint32, string_at
from dataclasses import replace
from pathlib import Path

import pytest

from omm_camera_driver.clocks import Clocks, WallClock, read_clocks
from omm_camera_driver.driver import CameraSettings, Frame
from omm_camera_driver.drivers.genicam import aravis
from omm_camera_driver.drivers.genicam.driver import GenicamDriver
from omm_camera_driver.drivers.genicam.link import Linked
from omm_camera_driver.drivers.usb3.link import Usb3Link, Usb3Options
from omm_core.errors import DeviceError, InputError

_BINNING_X, _GAIN_AUTO, _PIXEL_FORMAT, _TRIGGER_MODE = 0x108, 0x114, 0x128, 0x300
_YUV422 = 0x02100032
_LATCHED, _LIMIT = 0x608, 0x610


class UsedLink(Usb3Link):
    """To Aravis' camera, after others have used it."""

    def __init__(self, options: Usb3Options, left: dict[int, int]) -> None:
        super().__init__(options)
        self._left = left

    def interface(self) -> int:
        return int(self._arv.fake_interface_get_instance())

    def open(self) -> Linked:
        linked = super().open()
        for register, value in self._left.items():
            self.write(register, value)
        return linked

    def write(self, register: int, value: int) -> None:
        inner = self._arv.fake_device_get_fake_camera(self._device)
        self._arv.fake_camera_write_register(inner, register, value)

    def read(self, register: int) -> int:
        value = c_uint32()
        inner = self._arv.fake_device_get_fake_camera(self._device)
        self._arv.fake_camera_read_register(inner, register, byref(value))
        return value.value


class Opened:
    """A driver on such a camera."""

    def __init__(self, options: Usb3Options, left: dict[int, int]) -> None:
        self.link = UsedLink(options, left)
        self.driver = GenicamDriver(self.link)


Make = Callable[..., Opened]


@pytest.fixture(scope="module")
def arv() -> aravis.Aravis:
    try:
        return aravis.load()
    except aravis.AravisMissing as missing:
        pytest.skip(str(missing))


@pytest.fixture
def opened(arv: aravis.Aravis) -> Iterator[Make]:
    made: list[Opened] = []

    def make(options: Usb3Options | None = None, left: dict[int, int] | None = None) -> Opened:
        made.append(Opened(options or Usb3Options(), left or {}))
        return made[-1]

    yield make
    for one in made:
        one.driver.close()


def _next(driver: GenicamDriver) -> Frame:
    frame = next((f for f in (driver.next_frame(0.5) for _ in range(10)) if f is not None), None)
    assert frame is not None
    return frame


# --- what the standard has and Aravis' camera lacks: a clock, a limit ---

_FEATURES = b"""
  <Command Name="TimestampLatch"><pValue>LatchRegister</pValue>
    <CommandValue>1</CommandValue></Command>
  <IntReg Name="LatchRegister"><Address>0x600</Address><Length>4</Length><AccessMode>RW</AccessMode>
    <pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <Integer Name="TimestampLatchValue"><pValue>LatchedRegister</pValue></Integer>
  <IntReg Name="LatchedRegister"><Address>0x608</Address><Length>8</Length>
    <AccessMode>RO</AccessMode>
    <pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <Integer Name="DeviceLinkThroughputLimit"><pValue>LimitRegister</pValue>
    <Min>10000000</Min><Max>400000000</Max></Integer>
  <IntReg Name="LimitRegister"><Address>0x610</Address><Length>4</Length><AccessMode>RW</AccessMode>
    <pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
"""


class _Replaced:
    """Aravis with some functions replaced."""

    def __init__(self, arv: aravis.Aravis, **functions: Callable[..., object]) -> None:
        self._arv = arv
        self.__dict__.update(functions)

    def __getattr__(self, name: str) -> object:
        return getattr(self._arv, name)


@pytest.fixture
def standard(
    arv: aravis.Aravis, tmp_path: Path, opened: Make, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Make]:
    """Make cameras with those features; theirs is the computer's wall clock."""
    plain = arv.fake_camera_new(b"plain")
    size = c_size_t()
    xml = string_at(arv.fake_camera_get_genicam_xml(plain, byref(size)), size.value)
    arv.g_object_unref(plain)
    path = tmp_path / "camera.xml"
    xml = xml.rstrip(b"\0").replace(b"<!-- Port -->", _FEATURES + b"<!-- Port -->")
    yuv = b'<EnumEntry Name="YUV422Packed"><Value>%d</Value></EnumEntry>' % _YUV422
    path.write_bytes(xml.replace(b'<EnumEntry Name="Mono16"', yuv + b'<EnumEntry Name="Mono16"'))
    arv.set_fake_camera_genicam_filename(str(path).encode())

    def make(
        options: Usb3Options | None = None,
        *,
        ahead_ns: int = 0,
        left: dict[int, int] | None = None,
    ) -> Opened:
        one = opened(options, left)

        def execute(camera: int, command: bytes) -> None:
            arv.camera_execute_command(camera, command)
            if command == b"TimestampLatch":
                now_ns = time.time_ns() + ahead_ns
                one.link.write(_LATCHED, now_ns >> 32)
                one.link.write(_LATCHED + 4, now_ns & 0xFFFFFFFF)

        monkeypatch.setattr(one.link, "_arv", _Replaced(arv, camera_execute_command=execute))
        return one

    yield make
    arv.set_fake_camera_genicam_filename(None)


_SMALL = CameraSettings(width_px=64, height_px=32, pixel_format="Mono8", frame_rate_hz=100.0)


def test_the_stamp_is_of_the_latched_clock(standard: Make) -> None:
    one = standard()
    one.driver.open(_SMALL)
    assert one.driver.health()["clock"] == "latched"
    one.driver.start()
    before_ns = time.time_ns()
    frames = [_next(one.driver) for _ in range(3)]
    for frame in frames:
        begin_ns = frame.exposure_mid_ns - frame.exposure_ns // 2
        unsure_ns = frame.stamp_uncertainty_ns
        assert before_ns - 10**9 < begin_ns - unsure_ns < time.time_ns()
        assert unsure_ns < 10**8
    assert one.driver.health()["clock"] == "latched"


def test_a_system_clock_that_is_set_moves_the_stamps_and_not_the_camera_s_clock(
    standard: Make, arv: aravis.Aravis
) -> None:
    one = standard()
    step_ns = 0

    def clocks() -> Clocks:
        now = read_clocks()
        return replace(now, system_ns=now.system_ns + step_ns)

    def arrived(buffer: int) -> int:
        return int(arv.buffer_get_system_timestamp(buffer)) + step_ns

    one.driver._wall = WallClock(clocks)
    one.driver._arv = _Replaced(arv, buffer_get_system_timestamp=arrived)  # type: ignore[assignment]
    one.driver.open(_SMALL)
    one.driver.start()
    for set_by_s in (0, 3600, -3600):
        step_ns = set_by_s * 10**9
        frame = _next(one.driver)
        now_ns = time.time_ns() + step_ns
        begin_ns = frame.exposure_mid_ns - frame.exposure_ns // 2
        assert now_ns - 60 * 10**9 < begin_ns < now_ns + frame.stamp_uncertainty_ns
        assert frame.stamp_uncertainty_ns < 10**8
        assert one.driver.health()["clock"] == "latched"


def test_a_latched_clock_that_is_not_the_stamps_is_told_and_not_used(standard: Make) -> None:
    one = standard(ahead_ns=-(10**12))
    one.driver.open(_SMALL)
    one.driver.start()
    frame = _next(one.driver)
    assert abs(frame.exposure_mid_ns - time.time_ns()) < 2 * 10**9
    assert "reads other than it stamps" in one.driver.health()["clock"]


def test_the_bandwidth_is_limited_in_the_standards_unit(standard: Make) -> None:
    one = standard(Usb3Options(bandwidth_mb_per_s=200.0))
    assert one.driver.open(_SMALL).granted["usb_bandwidth_mb_per_s"] == 200.0
    assert one.link.read(_LIMIT) == 200_000_000


def test_a_bandwidth_out_of_range_is_refused_with_the_range(standard: Make) -> None:
    with pytest.raises(InputError, match=r"from 1e\+07 to 4e\+08 B/s"):
        standard(Usb3Options(bandwidth_mb_per_s=1000.0)).driver.open(_SMALL)


# --- what a former user left behind ---


def test_binning_of_a_former_user_is_taken_back_and_told(opened: Make) -> None:
    one = opened(left={_BINNING_X: 2, _TRIGGER_MODE: 1})
    camera = one.driver.open(CameraSettings())
    assert one.link.read(_BINNING_X) == 1
    assert one.link.read(_TRIGGER_MODE) == 0
    assert any("BinningHorizontal was 2" in note for note in camera.notes)


def test_binning_that_is_asked_for_stays(opened: Make) -> None:
    one = opened()
    camera = one.driver.open(CameraSettings(controls={"BinningHorizontal": "2"}))
    assert one.link.read(_BINNING_X) == 2
    assert camera.notes == ()


def test_an_automatic_that_was_left_on_is_told_and_ends_with_a_value(opened: Make) -> None:
    left = {_GAIN_AUTO: 2}
    (note,) = opened(left=left).driver.open(CameraSettings()).notes
    assert "GainAuto is Continuous" in note
    one = opened(left=left)
    assert one.driver.open(CameraSettings(gain=2.0)).notes == ()
    assert one.link.read(_GAIN_AUTO) == 1  # Off, as this camera numbers them


def test_what_the_camera_makes_something_else_of_is_told(opened: Make) -> None:
    camera = opened().driver.open(CameraSettings(exposure_us=2000.0, gain=2.5))
    assert camera.granted["gain"] == 2.0  # its gain is a whole number
    assert camera.notes == ("gain: asked for 2.5, the camera granted 2.",)


def test_a_pixel_format_that_nobody_reads_is_refused_with_those_that_are(standard: Make) -> None:
    one = standard(left={_PIXEL_FORMAT: _YUV422})
    with pytest.raises(InputError, match=r"set to YUV422Packed\. Set pixel_format to one of") as no:
        one.driver.open(CameraSettings())
    readable = str(no.value).partition("one of")[2]
    assert "Mono8" in readable
    assert "YUV422Packed" not in readable


# --- what the bus tells ---


def test_a_limit_that_the_camera_does_not_know_is_refused(opened: Make) -> None:
    with pytest.raises(InputError, match="usb_bandwidth_mb_per_s"):
        opened(Usb3Options(bandwidth_mb_per_s=100.0)).driver.open(CameraSettings())


def test_the_bus_s_own_errors_say_what_to_do(opened: Make, arv: aravis.Aravis) -> None:
    one = opened()

    def busy(*_: object) -> None:
        raise DeviceError("Failed to claim USB control interface: LIBUSB_ERROR_BUSY")

    one.link._arv = _Replaced(arv, interface_open_device=busy)  # type: ignore[assignment]
    with pytest.raises(DeviceError, match="another program holds it"):
        one.driver.open(CameraSettings())


def test_the_search_of_aravis_for_usb3_cameras_runs_here(arv: aravis.Aravis) -> None:
    """The real interface, on a computer without such a camera as a rule."""
    link = Usb3Link(Usb3Options(device="no such camera"))
    with pytest.raises(DeviceError, match="Expected a USB3 Vision camera called no such camera"):
        link.open()
