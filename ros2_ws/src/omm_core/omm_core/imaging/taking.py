"""What a camera asks of a place from which it takes an image, and the room that it needs there.

``imaging`` and ``body`` of camera.yaml (contract.md, "Files"), both optional.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection


@dataclass(frozen=True, kw_only=True)
class Imaging:
    """How images are taken; None where not told.

    Attributes
    ----------
    exposure_s : float or None
    focus_mm : tuple of two or None
        Nearest and farthest distance along the optical axis at which a target is in focus.
    max_tilt_rad : float or None
        Largest angle between a target's normal and the ray to the camera.
    """

    exposure_s: float | None = None
    focus_mm: tuple[float, float] | None = None
    max_tilt_rad: float | None = None


@dataclass(frozen=True, kw_only=True)
class Body:
    """The camera's housing: a cylinder about the taper's z axis.

    Attributes
    ----------
    radius_mm : float
    z_mm : tuple of two
        From where to where along the axis, taper frame.
    """

    radius_mm: float
    z_mm: tuple[float, float]


def read_imaging(root: YamlSection) -> Imaging:
    """Return ``imaging``; nothing is limited where it is absent."""
    if "imaging" not in root:
        return Imaging()
    section = root.section("imaging")
    return Imaging(
        exposure_s=section.number("exposure_s", above=0.0) if "exposure_s" in section else None,
        focus_mm=_ordered(section, "focus_mm", above=0.0) if "focus_mm" in section else None,
        max_tilt_rad=_tilt(section) if "max_tilt_rad" in section else None,
    )


def read_body(root: YamlSection) -> Body | None:
    """Return ``body``, or None where it is absent: the camera's own point."""
    if "body" not in root:
        return None
    section = root.section("body")
    return Body(radius_mm=section.number("radius_mm", above=0.0), z_mm=_ordered(section, "z_mm"))


def _tilt(section: YamlSection) -> float:
    tilt = section.number("max_tilt_rad", above=0.0)
    if tilt > math.pi / 2:
        raise InputError(
            f"{section.where}: expected max_tilt_rad up to π/2, got {tilt:g}. Is it in degrees?"
        )
    return tilt


def _ordered(section: YamlSection, key: str, above: float = -math.inf) -> tuple[float, float]:
    low, high = (float(v) for v in section.numbers(key, 2))
    if not above < low < high:
        least = f" above {above:g}" if math.isfinite(above) else ""
        raise InputError(
            f"{section.where}: expected {key} as [smaller, larger]{least}, got [{low:g}, {high:g}]."
        )
    return low, high
