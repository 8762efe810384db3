"""Which of the cameras that answer is meant."""

from omm_camera_driver.drivers.gige import gvcp
from omm_core.errors import DeviceError


def find(device: str) -> gvcp.FoundCamera:
    """Return the camera that is meant by a serial number, address, model, name, or nothing.

    Raises
    ------
    DeviceError
        There is none, or several, or its address cannot be reached from here.
    """
    direct = gvcp.ask(device) if device.count(".") == 3 else None
    if direct is not None:
        return direct
    there = gvcp.discover(0.3)
    meant = [c for c in there if not device or c.is_called(device)]
    if not meant:
        others = ", ".join(label_of(c) for c in there) or "none"
        called = f" called {device}" if device else ""
        raise DeviceError(
            f"Expected a GigE Vision camera{called}, found {others}. "
            "Check cable, power and the camera's address (./omm cameras)."
        )
    if len(meant) > 1:
        raise DeviceError(
            f"Expected one camera, found {', '.join(label_of(c) for c in meant)}. Name one by its "
            "serial number in the parameter device."
        )
    reason = meant[0].why_unreachable()
    if reason:
        raise DeviceError(f"{label_of(meant[0])} cannot be used: {reason}.")
    return meant[0]


def label_of(camera: gvcp.FoundCamera) -> str:
    """Return how a camera is called in messages."""
    return f"{camera.vendor} {camera.model} {camera.serial} at {camera.address}"
