"""Which driver a node's parameters ask for. A new kind of camera is one more function here."""

from collections.abc import Callable

from omm_camera_driver.driver import CameraDriver
from omm_camera_driver.drivers.simulated.true_poses import TruePoses
from omm_camera_driver.parameters import Parameters
from omm_core.errors import InputError

MakeDriver = Callable[[], CameraDriver]


def gige(parameters: Parameters, poses: TruePoses) -> MakeDriver:
    """Make the driver of GigE Vision cameras, through Aravis."""
    from omm_camera_driver.drivers.genicam.driver import GenicamDriver
    from omm_camera_driver.drivers.gige.link import GigeLink, GigeOptions

    options = GigeOptions(
        device=parameters.device,
        packet_size_bytes=parameters.packet_size_bytes,
        socket_buffer_bytes=parameters.socket_buffer_bytes,
        packet_resend=parameters.packet_resend,
    )
    ptp = parameters.ptp
    return lambda: GenicamDriver(GigeLink(options), ptp=ptp)


def usb3(parameters: Parameters, poses: TruePoses) -> MakeDriver:
    """Make the driver of USB3 Vision cameras, through Aravis."""
    from omm_camera_driver.drivers.genicam.driver import GenicamDriver
    from omm_camera_driver.drivers.usb3.link import Usb3Link, Usb3Options

    if parameters.ptp:
        raise InputError("Expected ptp false: USB has no PTP; the camera's own clock is read.")
    options = Usb3Options(
        device=parameters.device,
        mode=parameters.usb_mode,
        bandwidth_mb_per_s=parameters.usb_bandwidth_mb_per_s,
    )
    return lambda: GenicamDriver(Usb3Link(options))


def v4l2(parameters: Parameters, poses: TruePoses) -> MakeDriver:
    """Make the driver of Video4Linux: USB cameras and others with a /dev/video node."""
    from omm_camera_driver.drivers.v4l2.driver import V4l2Driver

    device, readout_ms = parameters.device, parameters.readout_ms
    return lambda: V4l2Driver(device, readout_ns=round(readout_ms * 1e6))


def simulated(parameters: Parameters, poses: TruePoses) -> MakeDriver:
    """Make the driver of the simulated cell's camera."""
    from omm_camera_driver.drivers.simulated.cell_view import cell_view
    from omm_camera_driver.drivers.simulated.driver import SimulatedDriver

    view = cell_view(
        parameters.scenario,
        parameters.seed,
        clamping_seed=parameters.clamping_seed,
        repeat=parameters.repeat,
        bumped_id=parameters.bumped_id,
    )
    return lambda: SimulatedDriver(view, poses)


DRIVERS: dict[str, Callable[[Parameters, TruePoses], MakeDriver]] = {
    "gige": gige,
    "usb3": usb3,
    "v4l2": v4l2,
    "simulated": simulated,
}
