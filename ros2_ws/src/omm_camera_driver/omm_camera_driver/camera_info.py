"""`sensor_msgs/CameraInfo` from a calibration file, or from a ROS calibration."""

import math
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np
import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from sensor_msgs.msg import CameraInfo, RegionOfInterest

from omm_core.errors import InputError
from omm_core.files.output import write_whole
from omm_core.files.yaml_input import read_yaml
from omm_core.imaging.calibration import load_calibration
from omm_core.imaging.lens import BrownPhotogrammetric, PlumbBob


@dataclass(frozen=True, kw_only=True)
class InfoSource:
    """A message without stamp, and how far off its lens is at most (px)."""

    message: CameraInfo
    largest_error_px: float = 0.0


def from_calibration(path: str) -> InfoSource:
    """Return the CameraInfo of a calibration file.

    The model is plumb_bob: fitted where the file has another one.
    """
    lens = load_calibration(path).lens
    if isinstance(lens, BrownPhotogrammetric):
        plumb_bob, error_px = lens.to_plumb_bob()
    elif isinstance(lens, PlumbBob):
        plumb_bob, error_px = lens, 0.0
    else:
        raise InputError(f"{path}: expected a lens with a plumb_bob form, got {type(lens)}.")
    return InfoSource(message=_message(plumb_bob), largest_error_px=error_px)


def from_url(url: str) -> InfoSource:
    """Return the CameraInfo in the YAML file that ROS's camera_calibration writes.

    Raises
    ------
    InputError
        The address or the file cannot be used.
    """
    root = read_yaml(_path(url), "camera info file")
    model = root.text("distortion_model")
    if model != "plumb_bob":
        raise InputError(f"{root.where}: expected distortion_model plumb_bob, got {model}.")
    k = root.section("camera_matrix").numbers("data", 9)
    d = root.section("distortion_coefficients").numbers("data", 5)
    lens = PlumbBob(
        width_px=root.integer("image_width", minimum=1),
        height_px=root.integer("image_height", minimum=1),
        fx_px=float(k[0]), cx_px=float(k[2]), fy_px=float(k[4]), cy_px=float(k[5]),
        k1=float(d[0]), k2=float(d[1]), p1=float(d[2]), p2=float(d[3]), k3=float(d[4]),
    )  # fmt: skip
    return InfoSource(message=_message(lens))


def keep(url: str, message: CameraInfo) -> InfoSource:
    """Write a calibration, as ROS's camera_calibration sends it, to the file of an address.

    Returns
    -------
    InfoSource
        What was read back from there.

    Raises
    ------
    InputError
        It is not a plumb_bob calibration, or the file cannot be written.
    """
    if message.distortion_model != "plumb_bob" or len(message.d) != 5:
        raise InputError(
            f"Expected a plumb_bob calibration with 5 coefficients, got "
            f"{message.distortion_model or 'none'} with {len(message.d)}."
        )
    numbers = [*message.k, *message.d, *message.r, *message.p]
    if not (message.k[0] > 0.0 and message.width and all(map(math.isfinite, numbers))):
        raise InputError("Expected a calibration with a focal length and finite numbers.")
    content = {
        "image_width": message.width,
        "image_height": message.height,
        "camera_name": "camera",
        "camera_matrix": _matrix(3, message.k),
        "distortion_model": message.distortion_model,
        "distortion_coefficients": _matrix(1, message.d),
        "rectification_matrix": _matrix(3, message.r),
        "projection_matrix": _matrix(3, message.p),
    }
    write_whole(_path(url), yaml.safe_dump(content, sort_keys=False, default_flow_style=None))
    return from_url(url)


def _matrix(rows: int, values: Iterable[float]) -> dict[str, object]:
    data = [float(value) for value in values]
    return {"rows": rows, "cols": len(data) // rows, "data": data}


def uncalibrated() -> InfoSource:
    """Return a message that says, as ROS does by K[0] = 0, that nothing is known."""
    return InfoSource(message=CameraInfo())


def for_image(
    calibrated: CameraInfo, size_px: tuple[int, int], region_px: tuple[int, int] | None
) -> CameraInfo:
    """Return what holds for an image, by its size.

    Parameters
    ----------
    calibrated : of the whole sensor
    size_px : width and height of the image
    region_px : upper left corner of a region of the sensor; None where none was asked for

    Returns
    -------
    CameraInfo
        With its region of interest where one was asked for. An image of another size for any other
        reason (binned, scaled) is uncalibrated: its pixels are not those that were calibrated.
    """
    info = copy(calibrated)
    width, height = size_px
    if calibrated.k[0] == 0.0:
        info.width, info.height = width, height
    elif size_px != (calibrated.width, calibrated.height):
        if region_px is None:
            return CameraInfo(width=width, height=height)
        info.roi = RegionOfInterest(
            width=width, height=height, x_offset=region_px[0], y_offset=region_px[1]
        )
    return info


def _path(url: str) -> Path:
    parts = urlparse(url)
    if parts.scheme == "file":
        return Path(unquote(parts.path))
    if parts.scheme == "package":
        try:
            return Path(get_package_share_directory(parts.netloc)) / unquote(parts.path).lstrip("/")
        except PackageNotFoundError:
            raise InputError(f"camera_info_url: there is no package {parts.netloc}.") from None
    raise InputError(f"camera_info_url: expected file:///… or package://package/…, got {url!r}.")


def _message(lens: PlumbBob) -> CameraInfo:
    message = CameraInfo(width=lens.width_px, height=lens.height_px, distortion_model="plumb_bob")
    message.d = [float(value) for value in lens.distortion]
    message.k = [float(value) for value in lens.camera_matrix.ravel()]
    message.r = [float(value) for value in np.eye(3).ravel()]
    projection = np.column_stack([lens.camera_matrix, np.zeros(3)])
    message.p = [float(value) for value in projection.ravel()]
    return message
