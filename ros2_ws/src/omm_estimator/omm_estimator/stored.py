"""A result that was stored by ``./omm solve --json`` (or ``demo --json``), as the node says it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.json_input import read_json
from omm_core.files.yaml_input import YamlSection
from omm_core.part_pose import THETA_NAMES

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredPose:
    """A pose of the part in one of the two machine frames: rad and mm, in the order of θ."""

    theta: Array
    """(7,)."""
    covariance: Array
    """(7, 7)."""
    expanded_uncertainty: Array
    """(7,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredResult:
    """What a later reader needs of a measurement."""

    part: str
    model: str
    stamp_ns: int
    """Of the newest image that was used."""
    own: StoredPose
    absolute: StoredPose
    geometry_declared: bool
    rms_px: float
    sigma0: float
    degrees_of_freedom: int


def load_result(path: str) -> StoredResult:
    """Read a result.

    Raises
    ------
    InputError
        The file holds no result, or one that is not determined or did not converge.
    """
    root = read_json(path, "result")
    content = root.get("result", root)  # demo --json has the truth beside it
    section = YamlSection(content, f"The result {path}", Path(path).parent)
    if content.get("determined", True) is not True or section.get("converged") is not True:
        raise InputError(f"{section.where} is not determined: there is no pose to publish.")
    absolute = section.section("absolute")
    return StoredResult(
        part=section.text("part"),
        model=section.text("model"),
        stamp_ns=_newest(section),
        own=_pose(section),
        absolute=_pose(absolute),
        geometry_declared=absolute.get("declared") is True,
        rms_px=section.number("rms_px"),
        sigma0=_number_or_nan(section, "sigma0"),
        degrees_of_freedom=section.integer("degrees_of_freedom"),
    )


def _pose(section: YamlSection) -> StoredPose:
    theta = section.section("theta")
    covariance = _covariance(section)
    return StoredPose(
        theta=np.array([theta.number(name) for name in THETA_NAMES]),
        covariance=covariance,
        expanded_uncertainty=section.numbers("expanded_uncertainty", 7),
    )


def _covariance(section: YamlSection) -> Array:
    rows = section.get("covariance")
    problem = f"{section.where}: covariance: expected 7 rows of 7 finite numbers, symmetric."
    if not isinstance(rows, list) or any(not isinstance(row, list) for row in rows):
        raise InputError(problem)
    flat: list[Any] = [value for row in rows for value in row]
    good = all(type(value) in (int, float) and math.isfinite(value) for value in flat)
    if not good or len(rows) != 7 or any(len(row) != 7 for row in rows):
        raise InputError(problem)
    covariance = np.array(rows, dtype=float)
    scale = np.sqrt(np.abs(np.outer(np.diag(covariance), np.diag(covariance))))
    if np.any(np.diag(covariance) < 0) or np.any(np.abs(covariance - covariance.T) > 1e-6 * scale):
        raise InputError(problem)
    return covariance


def _newest(section: YamlSection) -> int:
    stamps = [
        image.integer("stamp_ns", maximum=2**63 - 1)
        for image in section.sections("images")
        if image.get("used") is True
    ]
    if not stamps:
        raise InputError(f"{section.where}: expected images that were used, found none.")
    return max(stamps)


def _number_or_nan(section: YamlSection, key: str) -> float:
    return math.nan if section.get(key) is None else section.number(key)
