"""Parameters of the camera node."""

import math
from dataclasses import dataclass

from omm_camera_driver.driver import CameraSettings, Trigger
from omm_core.errors import InputError
from omm_ros.parameters import network_parameter, parameter

DRIVERS = ("gige", "usb3", "v4l2", "simulated")
NAN = math.nan


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """What can be set on the camera node. 0, NaN and "" leave a setting as the camera has it."""

    driver: str = parameter("simulated", "Which kind of camera.", choices=DRIVERS)
    device: str = parameter(
        "",
        "Which camera: serial number, address, model, port or device path; the only one if empty.",
    )
    frame_id: str = parameter("camera_optical", "Frame of the images.")
    frame_prefix: str = parameter("", "Prefix of every frame's name, for several machines: mill1/.")
    calibration_file: str = parameter(
        "", "camera.yaml of the calibrated camera; camera_info is made of it."
    )
    camera_info_url: str = parameter(
        "", "file:// or package:// address of a ROS calibration, instead of calibration_file."
    )
    trigger: str = parameter(
        "continuous",
        "What makes the camera take an image; software means ~/trigger and ~/take_image.",
        choices=tuple(t.value for t in Trigger),
    )
    trigger_timeout_s: float = parameter(
        3.0, "How long a triggered image may take.", minimum=0.1, maximum=60.0
    )
    trigger_line: str = parameter("", "Input line of the hardware trigger, as the camera names it.")
    strobe_line: str = parameter(
        "", "Output line that is on during the exposure, for the ring light."
    )
    exposure_us: float = parameter(
        0.0, "Exposure time; 0 leaves it.", minimum=0.0, maximum=6e7, read_only=False
    )
    gain: float = parameter(
        NAN, "Gain in the camera's unit, usually dB; NaN leaves it.", read_only=False
    )
    black_level: float = parameter(NAN, "Black level in the camera's unit; NaN leaves it.")
    frame_rate_hz: float = parameter(
        0.0, "Images per second in continuous mode; 0 leaves it.", minimum=0.0, maximum=1e4
    )
    pixel_format: str = parameter("", "As the camera names it: Mono8, Mono12Packed, GREY, YUYV, …")
    roi_width_px: int = parameter(0, "Width of the region of interest; 0 is all.", minimum=0)
    roi_height_px: int = parameter(0, "Height of the region of interest; 0 is all.", minimum=0)
    roi_x_px: int = parameter(0, "Left edge of the region of interest.", minimum=0)
    roi_y_px: int = parameter(0, "Upper edge of the region of interest.", minimum=0)
    controls: tuple[str, ...] = parameter(
        ("",), "Anything else, by the camera's own names: name=value."
    )
    packet_size_bytes: int = parameter(
        0, "gige: size of the packets; 0 negotiates the largest that arrives.", minimum=0
    )
    socket_buffer_bytes: int = parameter(
        8_000_000, "gige: receive buffer of the socket.", minimum=100_000
    )
    packet_resend: bool = parameter(True, "gige: ask for lost packets again.")
    ptp: bool = parameter(False, "gige: let the camera keep PTP time (IEEE 1588).")
    usb_mode: str = parameter(
        "async", "usb3: how the bus is read; sync is slower.", choices=("async", "sync")
    )
    usb_bandwidth_mb_per_s: float = parameter(
        0.0, "usb3: what the camera may send at most, where several share a bus; 0 leaves it.",
        minimum=0.0,
    )  # fmt: skip
    readout_ms: float = parameter(
        0.0, "v4l2: time from the end of the exposure to the driver's stamp; 0: not known.",
        minimum=0.0,
    )  # fmt: skip
    scenario: str = parameter("bench", "simulated: what the cell is made of; a name or a path.")
    seed: int = parameter(1, "simulated: equal seeds make equal cells.", minimum=0)
    clamping_seed: int = parameter(
        -1, "simulated: draws the clamping angle alone; -1 takes the seed.", minimum=-1
    )
    repeat: int = parameter(1, "simulated: number of the measurement in that clamping.", minimum=1)
    bumped_id: int = parameter(
        -1, "simulated: a target that is not where the part file says; -1: none.", minimum=-1
    )
    network: bool = network_parameter()


def camera_settings(parameters: Parameters) -> CameraSettings:
    """Return what the parameters ask of the camera.

    Raises
    ------
    InputError
        One of `controls` is not name=value.
    """
    return CameraSettings(
        exposure_us=parameters.exposure_us or None,
        gain=_number(parameters.gain),
        black_level=_number(parameters.black_level),
        frame_rate_hz=parameters.frame_rate_hz or None,
        pixel_format=parameters.pixel_format or None,
        width_px=parameters.roi_width_px or None,
        height_px=parameters.roi_height_px or None,
        offset_x_px=parameters.roi_x_px,
        offset_y_px=parameters.roi_y_px,
        trigger=Trigger(parameters.trigger),
        trigger_line=parameters.trigger_line,
        strobe_line=parameters.strobe_line,
        controls=dict(_control(text) for text in parameters.controls if text),
    )


def check_exposure(parameters: Parameters) -> None:
    """Refuse an exposure that no triggered image can be waited for.

    Raises
    ------
    InputError
        It is as long as a triggered image may take.
    """
    exposure_s, timeout_s = parameters.exposure_us / 1e6, parameters.trigger_timeout_s
    if Trigger(parameters.trigger) is Trigger.SOFTWARE and exposure_s >= timeout_s:
        raise InputError(
            f"Expected trigger_timeout_s longer than the exposure of {exposure_s:g} s, got "
            f"{timeout_s:g} s."
        )


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


def _control(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise InputError(f"Parameter controls: expected name=value, got {text!r}.")
    return name.strip(), value.strip()
