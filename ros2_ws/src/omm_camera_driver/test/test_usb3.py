"""The link to USB3 Vision cameras, as far as it goes without one (with one: `usb3_cases.py`).

Aravis' fake device hangs on no Ethernet either: it is listed, opened, triggered and asked through
the same calls. The kernel's list of USB devices is a copy of what Linux shows of such a camera.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from omm_camera_driver.driver import CameraSettings, DeviceLost, Frame, Trigger
from omm_camera_driver.drivers.genicam import aravis
from omm_camera_driver.drivers.genicam.driver import GenicamDriver
from omm_camera_driver.drivers.usb3.finding import ListedCamera, choose, seen_as
from omm_camera_driver.drivers.usb3.link import Usb3Link, Usb3Options
from omm_camera_driver.drivers.usb3.sysfs import PluggedCamera, plugged
from omm_core.errors import DeviceError

SETTINGS = CameraSettings(trigger=Trigger.SOFTWARE, exposure_us=5000.0, pixel_format="Mono8")


class FakeLink(Usb3Link):
    """The same link, to the device that Aravis has in itself."""

    def interface(self) -> int:
        return int(self._arv.fake_interface_get_instance())


@pytest.fixture
def driver() -> Iterator[GenicamDriver]:
    try:
        aravis.load()
    except aravis.AravisMissing as missing:
        pytest.skip(str(missing))
    opened = GenicamDriver(FakeLink(Usb3Options()))
    yield opened
    opened.close()


def take(driver: GenicamDriver) -> Frame:
    driver.flush()
    driver.trigger()
    frame = driver.next_frame(5.0)
    assert frame is not None
    assert frame.complete
    return frame


def test_a_camera_that_is_on_no_network_is_opened_triggered_and_checked(
    driver: GenicamDriver,
) -> None:
    camera = driver.open(SETTINGS)
    assert (camera.vendor, camera.model, camera.serial) == ("Aravis", "Fake", "1")
    assert camera.granted["exposure_us"] == 5000.0
    assert "packet_size_bytes" not in camera.granted
    driver.start()
    for expected in (1, 2, 3):
        asked_ns = time.time_ns()
        frame = take(driver)
        assert frame.image.shape == (512, 512)
        assert asked_ns < frame.exposure_mid_ns + frame.stamp_uncertainty_ns
        driver.check()
        assert driver.health()["frames_received"] == expected
    assert "packets_resent" not in driver.health()


def test_an_unplugged_camera_is_lost_with_advice(
    driver: GenicamDriver, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver.open(SETTINGS)

    def gone(*_: object) -> None:
        raise DeviceError("LIBUSB_ERROR_NO_DEVICE")

    monkeypatch.setattr(aravis.load(), "device_read_register", gone)
    with pytest.raises(DeviceLost, match=r"NO_DEVICE.*USB port"):
        driver.check()


def shown_by_linux(root: Path, *, speed: str = "5000", serial: str = "26760164D0A1") -> Path:
    """/sys/bus/usb/devices with a hub, a keyboard and one USB3 Vision camera."""
    devices = root / "devices"
    for name, interface in (
        ("usb2:1.0", ("09", "00", "00")),
        ("2-1:1.0", ("03", "01", "01")),
        ("2-1.4:1.0", ("ef", "05", "00")),
        ("2-1.4:1.1", ("ef", "05", "02")),
    ):
        folder = devices / name
        folder.mkdir(parents=True)
        for file, text in zip(
            ("bInterfaceClass", "bInterfaceSubClass", "bInterfaceProtocol"), interface, strict=True
        ):
            (folder / file).write_text(f"{text}\n")
    camera = devices / "2-1.4"
    camera.mkdir()
    for file, text in {
        "manufacturer": "Maker", "product": "M-500", "serial": serial,
        "busnum": "2", "devnum": "7", "speed": speed,
    }.items():  # fmt: skip
        (camera / file).write_text(f"{text}\n")
    return devices


def test_cameras_are_told_from_other_usb_devices(tmp_path: Path) -> None:
    node = tmp_path / "nodes" / "002" / "007"
    node.parent.mkdir(parents=True)
    node.touch()
    (camera,) = plugged(shown_by_linux(tmp_path), tmp_path / "nodes")
    assert camera == PluggedCamera(
        vendor="Maker", model="M-500", serial="26760164D0A1", port="2-1.4", node=node,
        speed_mbps=5000,
    )  # fmt: skip
    assert (camera.problem(), camera.slow()) == ("", "")


def test_a_camera_whose_device_file_is_missing_points_at_the_container(tmp_path: Path) -> None:
    (camera,) = plugged(shown_by_linux(tmp_path), tmp_path / "no nodes")
    assert "--device /dev/bus/usb" in camera.problem()


def test_a_camera_without_the_right_to_use_it_says_which_rule_gives_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = tmp_path / "nodes" / "002" / "007"
    node.parent.mkdir(parents=True)
    node.touch()
    monkeypatch.setattr("os.access", lambda *_: False)
    (camera,) = plugged(shown_by_linux(tmp_path), tmp_path / "nodes")
    rule = next((Path(__file__).parents[1] / "udev").glob("*.rules"))
    assert rule.name in camera.problem()
    with pytest.raises(DeviceError, match=f"found none.*{rule.name}"):
        choose("", [], [camera])


def test_a_camera_behind_usb_2_says_so(tmp_path: Path) -> None:
    (camera,) = plugged(shown_by_linux(tmp_path, speed="480"))
    assert "480 Mb/s only" in camera.slow()


def listed(serial: str, key: str) -> ListedCamera:
    return ListedCamera(key=key, vendor="Maker", model="M-500", serial=serial, place="")


def test_one_of_several_is_chosen_by_serial_number_or_guid_and_never_at_random() -> None:
    one, two = listed("22097655", "Maker-26760164D0A1"), listed("22097656", "Maker-26760164D0A2")
    assert choose("22097656", [one, two], []) == two
    assert choose("26760164D0A1", [one, two], []) == one
    assert choose("", [one], []) == one
    seen = [
        PluggedCamera(
            vendor="Maker", model="M-500", serial=f"26760164D0A{k}", port=f"2-1.{k}",
            node=Path("/dev"), speed_mbps=5000,
        )
        for k in (1, 2)
    ]  # fmt: skip
    assert choose("2-1.2", [one, two], seen) == two
    for name in ("", "M-500"):
        with pytest.raises(DeviceError, match=r"Expected one camera, found .*22097655.*22097656"):
            choose(name, [one, two], [])
    with pytest.raises(DeviceError, match="called 1, found Maker M-500 22097655"):
        choose("1", [one], [])


def test_what_the_kernel_knows_is_matched_by_the_guid(tmp_path: Path) -> None:
    camera = plugged(shown_by_linux(tmp_path))
    other = plugged(shown_by_linux(tmp_path / "other", serial="26760164D0A2"))
    wanted = listed("22097656", "Maker-26760164D0A2")
    assert seen_as(wanted, [*camera, *other]) == other[0]
    assert seen_as(listed("1", "Maker-FF"), [*camera, *other]) is None
