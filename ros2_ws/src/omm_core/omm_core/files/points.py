"""points.json: what a survey ends in and a fit begins with (contract.md, "Files")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.declared import expect_once
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
    """All points of a survey, in the order of the file.

    ``full`` is the covariance (3N, 3N) of all points, mm², or None where only each point's own
    is known.
    """

    target_family: str
    coded_dot_diameter_mm: float
    points: tuple[SurveyPoint, ...]
    full: Array | None = None

    def covariance(self, rows: Sequence[int]) -> Array:
        """Return the covariance (3K, 3K) of some points; zero where none is known."""
        if self.full is not None:
            which = np.concatenate([np.arange(3 * n, 3 * n + 3) for n in rows])
            return np.asarray(self.full[np.ix_(which, which)])
        covariance = np.zeros((3 * len(rows), 3 * len(rows)))
        for i, n in enumerate(rows):
            own = self.points[n].covariance_mm2
            if own is not None:
                covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = own
        return covariance


def load_points(path: Path) -> SurveyPoints:
    """Read points.json.

    Raises
    ------
    InputError
        Where the file is missing, malformed, or holds something that is not a finite number.
    """
    root = read_json(path, "points file")
    try:
        points = tuple(_point(entry) for entry in root["points"])
        family, diameter = str(root["target_family"]), float(root["coded_dot_diameter_mm"])
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: expected the points of a survey; {error}.") from None
    except KeyError as error:
        raise InputError(f"{path}: the key {error} is missing.") from None
    expect_once([point.name for point in points], str(path), "name")
    coded = [point.id for point in points if point.id is not None]
    expect_once(coded, str(path), "coded target")
    told = root.get("full_covariance")
    full = None if told is None else _full(path, told, points)
    return SurveyPoints(
        target_family=family, coded_dot_diameter_mm=diameter, points=points, full=full
    )


def _full(path: Path, told: Any, points: tuple[SurveyPoint, ...]) -> Array:
    """Read the covariance beside points.json, in the order of the points."""
    try:
        file, order = path.parent / str(told["file"]), [str(name) for name in told["order"]]
        given = np.load(file, allow_pickle=False)
    except (KeyError, TypeError):
        raise InputError(f"{path}: full_covariance needs 'file' and 'order'.") from None
    except (OSError, ValueError, EOFError) as error:
        raise InputError(
            f"{path}: the full covariance {told['file']} cannot be read: {error}. Copy it beside"
            " the points, or remove the key full_covariance."
        ) from None
    wanted = (3 * len(order), 3 * len(order))
    if given.shape != wanted or given.dtype.kind != "f" or not np.isfinite(given).all():
        raise InputError(
            f"{file}: expected {wanted[0]} x {wanted[1]} finite numbers, got {given.shape} of"
            f" {given.dtype}."
        )
    size = max(float(np.abs(given).max(initial=0.0)), 1e-300)
    if np.abs(given - given.T).max(initial=0.0) > 1e-6 * size or (
        len(given) and np.linalg.eigvalsh(given)[0] < -1e-6 * size * len(given)
    ):
        raise InputError(f"{file}: expected a covariance (symmetric, no negative variances).")
    row_of = {name: n for n, name in enumerate(order)}
    full = np.zeros((3 * len(points), 3 * len(points)))
    known = [n for n, point in enumerate(points) if point.name in row_of]
    to = np.concatenate([np.arange(3 * n, 3 * n + 3) for n in known] or [np.empty(0, int)])
    rows = [row_of[points[n].name] for n in known]
    source = np.concatenate([np.arange(3 * n, 3 * n + 3) for n in rows] or [np.empty(0, int)])
    full[np.ix_(to, to)] = given[np.ix_(source, source)]
    for n in set(range(len(points))) - set(known):
        own = points[n].covariance_mm2
        if own is not None:
            full[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] = own
    return np.asarray(0.5 * (full + full.T))


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
        length = float(np.linalg.norm(normal))
        if length < 1e-6:
            raise ValueError(f"normal of {name} has no direction")
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
