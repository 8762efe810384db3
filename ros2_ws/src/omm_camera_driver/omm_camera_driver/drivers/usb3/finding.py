"""Which of the USB3 Vision cameras is meant, among those that Aravis may open."""

from dataclasses import dataclass

from omm_camera_driver.drivers.genicam.aravis import Aravis
from omm_camera_driver.drivers.usb3.sysfs import PluggedCamera
from omm_core.errors import DeviceError


@dataclass(frozen=True, kw_only=True)
class ListedCamera:
    """A camera in Aravis' list.

    Attributes
    ----------
    key : str
        Aravis' name of it, which no other camera has.
    place : str
        Where it is plugged in, as Aravis tells it.
    """

    key: str
    vendor: str
    model: str
    serial: str
    place: str

    def is_called(self, name: str) -> bool:
        """Return whether the user asked for this: serial number, GUID, model, key or place."""
        return name in (self.serial, self.model, self.key, self.place) or (
            len(name) >= 8 and self.key.endswith(name)
        )

    def __str__(self) -> str:
        return f"{self.vendor} {self.model} {self.serial}"


def listed(arv: Aravis, interface: int) -> list[ListedCamera]:
    """Return the cameras of one of Aravis' interfaces.

    Parameters
    ----------
    interface : Aravis' `ArvInterface`
    """
    arv.interface_update_device_list(interface)

    def text(value: bytes | None) -> str:
        return (value or b"").decode("utf-8", "replace")

    return [
        ListedCamera(
            key=text(arv.interface_get_device_id(interface, i)),
            vendor=text(arv.interface_get_device_vendor(interface, i)),
            model=text(arv.interface_get_device_model(interface, i)),
            serial=text(arv.interface_get_device_serial_nbr(interface, i)),
            place=text(arv.interface_get_device_physical_id(interface, i)),
        )
        for i in range(arv.interface_get_n_devices(interface))
    ]


def choose(device: str, there: list[ListedCamera], seen: list[PluggedCamera]) -> ListedCamera:
    """Return the camera that is meant by a serial number, model, port or other name, or by nothing.

    Parameters
    ----------
    there : what Aravis may open
    seen : what is plugged in

    Raises
    ------
    DeviceError
        There is none, or several, or the right to use it is missing.
    """
    ports = [camera for camera in seen if camera.port == device]
    meant = [
        camera
        for camera in there
        if not device or camera.is_called(device) or seen_as(camera, seen) in ports
    ]
    if len(meant) == 1:
        return meant[0]
    if len(meant) > 1:
        raise DeviceError(
            f"Expected one camera, found {', '.join(map(str, meant))}. Name one by its serial "
            "number in the parameter device."
        )
    problems = [f"{c.vendor} {c.model} at {c.port}: {c.problem()}" for c in seen if c.problem()]
    others = ", ".join(map(str, there)) or "none"
    called = f" called {device}" if device else ""
    advice = "; ".join(problems) or "Check cable, power and port (./omm cameras)"
    raise DeviceError(f"Expected a USB3 Vision camera{called}, found {others}. {advice}.")


def seen_as(camera: ListedCamera, seen: list[PluggedCamera]) -> PluggedCamera | None:
    """Return what the kernel knows of a camera; None where that is not sure."""
    same = [c for c in seen if c.serial and camera.is_called(c.serial)]
    if not same and len(seen) == 1:
        same = seen
    return same[0] if len(same) == 1 else None
