"""The sections of camera.yaml that several files share: the sensor, and where the camera sits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from omm_core.files.declared import integer, number, text, values


@dataclass(frozen=True, kw_only=True)
class NamedSensor:
    """The camera and its sensor; the size of a pixel is None where it is not told."""

    name: Annotated[str, text()]
    width_px: Annotated[int, integer(minimum=1)]
    height_px: Annotated[int, integer(minimum=1)]
    pixel_size_mm: Annotated[float | None, number(above=0.0)] = None


@dataclass(frozen=True, kw_only=True)
class TaperToCamera:
    """``taper_T_camera``: translation, and Euler angles about X, Y, Z."""

    translation_mm: Annotated[tuple[float, ...], values(3)]
    euler_xyz_rad: Annotated[tuple[float, ...], values(3)]


@dataclass(frozen=True, kw_only=True)
class BrownIntrinsics:
    """The lens of a ``brown_photogrammetric`` camera, as its file has it."""

    focal_length_mm: Annotated[float, number(above=0.0)]
    principal_point_offset_px: Annotated[tuple[float, ...], values(2)]
    k1_px2: Annotated[float, number()]
    k2_px4: Annotated[float, number()]
    p1_px: Annotated[float, number()]
    p2_px: Annotated[float, number()]


@dataclass(frozen=True, kw_only=True)
class PlumbBobIntrinsics:
    """The lens of a ``plumb_bob`` camera (OpenCV's and ROS's)."""

    fx_px: Annotated[float, number()]
    fy_px: Annotated[float, number()]
    cx_px: Annotated[float, number()]
    cy_px: Annotated[float, number()]
    k1: Annotated[float, number()]
    k2: Annotated[float, number()]
    p1: Annotated[float, number()]
    p2: Annotated[float, number()]
    k3: Annotated[float, number()] = 0.0
