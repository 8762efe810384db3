"""`./omm cameras`: which cameras are there, and why one cannot be used."""

import argparse
import json
from dataclasses import asdict, dataclass
from typing import Protocol


@dataclass(frozen=True, kw_only=True)
class ListedCamera:
    """A camera as the list shows it.

    Attributes
    ----------
    driver : str
        Value of the camera node's parameter `driver`.
    device : str
        Value of the camera node's parameter `device`.
    problem : str
        Why it cannot be used; empty if it can.
    """

    driver: str
    device: str
    vendor: str
    model: str
    serial: str
    address: str
    problem: str


class _Named(Protocol):
    """What says of itself who made it."""

    @property
    def vendor(self) -> str: ...
    @property
    def model(self) -> str: ...
    @property
    def serial(self) -> str: ...


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--json", action="store_true", help="machine-readable, on standard output")
    parser.add_argument(
        "--timeout", type=float, default=1.0, metavar="S", help="how long to listen (default 1 s)"
    )


def run(args: argparse.Namespace) -> int:
    """List what answers."""
    cameras = [*_gige(args.timeout), *_usb3(), *_v4l2()]
    if args.json:
        print(json.dumps([asdict(camera) for camera in cameras], indent=1))
        return 0
    if not cameras:
        print("No camera answers. A simulated one: ./omm demo")
        return 0
    for camera in cameras:
        name = " ".join(part for part in (camera.vendor, camera.model) if part)
        serial = f", serial {camera.serial}" if camera.serial else ""
        print(f"{camera.driver:<6} {camera.address:<15} {name}{serial}")
        if camera.problem:
            print(f"{'':7}cannot be used: {camera.problem}")
        else:
            print(f"{'':7}-p driver:={camera.driver} -p device:={camera.device}")
    return 0


def _gige(timeout_s: float) -> list[ListedCamera]:
    from omm_camera_driver.drivers.gige import gvcp

    aravis = _aravis_problem()
    return [
        _listed("gige", c, c.address, aravis or c.why_unreachable() or _held(c.address))
        for c in gvcp.discover(timeout_s)
    ]


def _usb3() -> list[ListedCamera]:
    from omm_camera_driver.drivers.usb3 import sysfs

    aravis = _aravis_problem()
    return [_listed("usb3", c, c.port, aravis or c.problem()) for c in sysfs.plugged()]


def _listed(driver: str, found: _Named, address: str, problem: str) -> ListedCamera:
    return ListedCamera(
        driver=driver,
        device=found.serial or address,
        vendor=found.vendor,
        model=found.model,
        serial=found.serial,
        address=address,
        problem=problem,
    )


def _aravis_problem() -> str:
    """Return why Aravis cannot be used; empty if it can."""
    from omm_camera_driver.drivers.genicam import aravis

    try:
        aravis.load()
    except aravis.AravisMissing as error:
        return str(error)
    return ""


def _held(address: str) -> str:
    from omm_camera_driver.drivers.gige import gvcp

    return "another program holds it" if gvcp.is_held(address) else ""


def _v4l2() -> list[ListedCamera]:
    from omm_camera_driver.drivers.v4l2 import devices as v4l2_devices

    return [
        ListedCamera(
            driver="v4l2",
            device=found.path,
            vendor=found.driver,
            model=found.card,
            serial=found.bus,
            address=found.path,
            problem=found.problem,
        )
        for found in v4l2_devices.devices()
    ]
