"""The USB3 Vision link against a camera in the kernel; run by `kernel_vm.py`, in its machine."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from usb3_camera import GUID, MODEL, VENDOR, Usb3Camera, image

from omm_camera_driver.driver import CameraSettings, DeviceLost, Trigger
from omm_camera_driver.drivers.genicam import aravis
from omm_camera_driver.drivers.genicam.driver import GenicamDriver
from omm_camera_driver.drivers.usb3.link import Usb3Link, Usb3Options
from omm_camera_driver.drivers.usb3.sysfs import plugged
from omm_core.errors import DeviceError

UDEVD = Path("/lib/systemd/systemd-udevd")
SETTINGS = CameraSettings(trigger=Trigger.SOFTWARE, exposure_us=20_000.0, pixel_format="Mono8")

try:
    aravis.load()
except aravis.AravisMissing as missing:
    pytest.skip(str(missing), allow_module_level=True)


def driver_for(device: str = "", mode: str = "async") -> GenicamDriver:
    return GenicamDriver(Usb3Link(Usb3Options(device=device, mode=mode)))


def wait_for(there: bool) -> None:
    deadline_s = time.monotonic() + 60.0
    while bool(plugged()) != there:
        assert time.monotonic() < deadline_s
        time.sleep(0.1)


@pytest.fixture(scope="module")
def udevd() -> Iterator[bool]:
    """Whether udevd runs: without it, libusb does not hear of a camera that comes later."""
    if not UDEVD.exists():
        yield False
        return
    daemon = subprocess.Popen([UDEVD], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    subprocess.run(["udevadm", "control", "--ping"], check=True, timeout=60)
    yield True
    daemon.terminate()
    daemon.wait()


@pytest.fixture(scope="module")
def camera(udevd: bool) -> Iterator[Usb3Camera]:
    """One camera for all."""
    camera = Usb3Camera()
    wait_for(there=True)
    yield camera
    camera.unplug()
    wait_for(there=False)


def test_the_kernel_shows_it_and_its_slow_port(camera: Usb3Camera) -> None:
    (found,) = plugged()
    assert (found.vendor, found.model, found.serial) == (VENDOR, MODEL, GUID)
    assert found.problem() == ""
    assert "480 Mb/s only" in found.slow()


@pytest.mark.parametrize("name", ["", GUID, MODEL])
def test_it_is_opened_by_what_it_is_called(camera: Usb3Camera, name: str) -> None:
    driver = driver_for(name)
    opened = driver.open(SETTINGS)
    driver.close()
    assert (opened.vendor, opened.model) == (VENDOR, MODEL)
    assert opened.address == plugged()[0].port
    assert opened.granted["exposure_us"] == 20_000.0
    assert opened.granted["usb_mbps"] == 480


def test_another_name_is_refused_with_those_that_are_there(camera: Usb3Camera) -> None:
    with pytest.raises(DeviceError, match=f"called 4711, found {VENDOR} {MODEL}"):
        Usb3Link(Usb3Options(device="4711")).open()


@pytest.mark.parametrize("mode", ["async", "sync"])
def test_images_arrive_pixel_by_pixel_stamped_by_the_latched_clock(
    camera: Usb3Camera, mode: str
) -> None:
    driver = driver_for(mode=mode)
    driver.open(SETTINGS)
    driver.start()
    for number in (0, 1, 2) if mode == "async" else (3, 4, 5):
        driver.flush()
        driver.trigger()
        frame = driver.next_frame(20.0)
        assert frame is not None
        assert frame.complete
        np.testing.assert_array_equal(frame.image, image(number))
        middle_ns = camera.begin_ns() + 10_000_000
        assert abs(frame.exposure_mid_ns - middle_ns) <= frame.stamp_uncertainty_ns + 1_000_000
        driver.check()
    assert driver.health()["clock"] == "latched"
    assert "480 Mb/s only" in driver.health()["usb"]
    driver.close()


def test_while_one_program_has_it_another_is_told_so(camera: Usb3Camera) -> None:
    one, other = driver_for(), driver_for()
    one.open(SETTINGS)
    with pytest.raises(DeviceError, match="other program"):
        other.open(SETTINGS)
    other.close()
    one.check()
    one.close()


def test_a_pulled_cable_is_told_at_the_next_check(camera: Usb3Camera) -> None:
    driver = driver_for()
    driver.open(SETTINGS)
    driver.start()
    camera.unplug()
    wait_for(there=False)
    with pytest.raises(DeviceLost, match="USB port"):
        driver.check()
    driver.close()


def test_a_camera_that_is_plugged_in_again_is_used_again(camera: Usb3Camera, udevd: bool) -> None:
    if not udevd:
        pytest.skip("needs systemd-udevd (apt-get install udev)")
    camera.unplug()
    wait_for(there=False)
    again = Usb3Camera()
    wait_for(there=True)
    deadline_s = time.monotonic() + 30.0
    while True:
        driver = driver_for()
        try:
            driver.open(SETTINGS)
            break
        except DeviceError:
            driver.close()
            assert time.monotonic() < deadline_s
            time.sleep(0.25)
    driver.start()
    driver.trigger()
    frame = driver.next_frame(20.0)
    driver.close()
    again.unplug()
    assert frame is not None
    np.testing.assert_array_equal(frame.image, image(0))
