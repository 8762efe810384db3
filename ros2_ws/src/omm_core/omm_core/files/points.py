"""points.json: what a survey ends in and a fit begins with (contract.md, "Files")."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.json_input import read_json

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class SurveyPoint:
    """One measured target; mm, survey frame. ``id`` is None where it is not coded."""

    name: str
    id: int | None
    xyz_mm: Array
    normal: Array | None
    covariance_mm2: Array | None


@dataclass(frozen=True, kw_only=True, eq=False)
class SurveyPoints:
    """All points of a survey, in the order of the file."""

    target_family: str
    coded_dot_diameter_mm: float
    points: tuple[SurveyPoint, ...]


def load_points(path: Path) -> SurveyPoints:
    """Read points.json.

    Raises
    ------
    InputError
        Where the file is missing, malformed, or holds a number that is none.
    """
    root = read_json(path, "points file")
    try:
        points = tuple(_point(entry) for entry in root["points"])
        family, diameter = str(root["target_family"]), float(root["coded_dot_diameter_mm"])
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: expected the points of a survey; {error}.") from None
    except KeyError as error:
        raise InputError(f"{path}: the key {error} is missing.") from None
    names = [point.name for point in points]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{path}: expected each name once, got {', '.join(twice)} more than once.")
    return SurveyPoints(target_family=family, coded_dot_diameter_mm=diameter, points=points)


def _point(entry: dict[str, Any]) -> SurveyPoint:
    name = str(entry["name"])
    covariance = None
    if entry.get("covariance_mm2") is not None:
        covariance = _numbers(entry["covariance_mm2"], (3, 3), f"covariance_mm2 of {name}")
    elif entry.get("sigma_xyz_mm") is not None:
        covariance = np.diag(_numbers(entry["sigma_xyz_mm"], (3,), f"sigma_xyz_mm of {name}") ** 2)
    normal = None
    if entry.get("normal") is not None:
        normal = _numbers(entry["normal"], (3,), f"normal of {name}")
        length = np.linalg.norm(normal)
        if length < 1e-6:
            raise ValueError(f"normal of {name} must have a direction")
        normal = normal / length
    return SurveyPoint(
        name=name,
        id=int(entry["id"]) if entry.get("coded") else None,
        xyz_mm=_numbers(entry["xyz_mm"], (3,), f"xyz_mm of {name}"),
        normal=normal,
        covariance_mm2=covariance,
    )


def _numbers(values: Any, shape: tuple[int, ...], what: str) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{what} must be {' x '.join(map(str, shape))} finite numbers")
    return array
