"""What a camera asks of a place from which it takes an image, and the room that it needs there.

``imaging`` and ``body`` of camera.yaml (contract.md, "Files"), both optional.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from omm_core.errors import InputError
from omm_core.files.declared import Reader, number, ordered
from omm_core.files.yaml_input import YamlSection


def _tilt(section: YamlSection, key: str) -> float:
    tilt = section.number(key, above=0.0)
    if tilt > math.pi / 2:
        raise InputError(
            f"{section.where}: expected {key} up to π/2, got {tilt:g}. Is it in degrees?"
        )
    return tilt


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

    exposure_s: Annotated[float | None, number(above=0.0)] = None
    focus_mm: Annotated[tuple[float, float] | None, ordered(above=0.0)] = None
    max_tilt_rad: Annotated[float | None, Reader(_tilt)] = None


@dataclass(frozen=True, kw_only=True)
class Body:
    """The camera's housing: a cylinder about the taper's z axis.

    Attributes
    ----------
    radius_mm : float
    z_mm : tuple of two
        From where to where along the axis, taper frame.
    """

    radius_mm: Annotated[float, number(above=0.0)]
    z_mm: Annotated[tuple[float, float], ordered()]
