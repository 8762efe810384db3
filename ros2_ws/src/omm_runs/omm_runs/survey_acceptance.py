"""Acceptance of a survey by calibrated lengths from a CSV."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from omm_core.errors import InputError
from omm_core.files.csv_input import read_table
from omm_core.files.survey import whole_number
from omm_core.survey.acceptance import CalibratedLength, accept, as_json
from omm_runs.survey_result import SurveyResult

CONSTANT_MM, PER_METRE_MM = 0.05, 0.02  # the paper's
_COLUMNS = ("first", "second", "length_mm")


def add_acceptance(
    found: SurveyResult,
    lengths: list[CalibratedLength],
    limit: tuple[float, float] = (CONSTANT_MM, PER_METRE_MM),
) -> bool:
    """Add the key ``acceptance`` to a survey's JSON, and its words to the findings; True if passed.

    Raises
    ------
    InputError, MeasurementError
    """
    check_limit(limit)
    xyz = found.delivered.xyz_mm
    result = accept(lengths, _measuring(found), float(np.linalg.norm(np.ptp(xyz, axis=0))), *limit)
    found.json["acceptance"] = as_json(result)
    worst = result.largest
    verdict = "keep to" if result.passed else "do NOT keep to"
    found.json["findings"] += [
        f"The {len(result.lengths)} lengths {verdict} {limit[0]:g} mm + {limit[1]:g} mm/m: largest"
        f" error {worst.error_mm:+.4f} mm at {worst.ends[0]}-{worst.ends[1]}"
        f" (limit {worst.limit_mm:.4f}). For the budget: u_out = LME / sqrt(3) ="
        f" {result.u_out_mm:.4f} mm at the longest, {result.longest_mm:.0f} mm.",
        *result.words,
    ]
    return result.passed


def check_limit(limit: tuple[float, float]) -> None:
    """Refuse a limit of lengths (mm, mm/m) that is none.

    Raises
    ------
    InputError
    """
    if not (np.isfinite(limit).all() and min(limit) >= 0.0 and max(limit) > 0.0):
        raise InputError(
            f"--limit: expected two numbers of 0 or more, not both 0: mm and mm/m, got {limit}."
        )


def _measuring(found: SurveyResult) -> Any:
    def measure(ends: tuple[int, int]) -> tuple[float, float] | None:
        if not all(end in found.delivered.numbers for end in ends):
            return None
        return found.network.length(ends)

    return measure


def read_lengths(path: Path) -> list[CalibratedLength]:
    """Read a CSV with the columns first, second (numbers of coded targets), length_mm.

    Raises
    ------
    InputError
        Where it is missing or malformed, or names a length twice: it would count as two of the
        lengths that the guideline asks for.
    """
    found: list[CalibratedLength] = []
    seen: dict[frozenset[int], str] = {}
    for row in read_table(path, "file of lengths", _COLUMNS, each="length").rows:
        first, second, length = row.numbers(_COLUMNS)
        if not length > 0.0:
            raise InputError(f"{row.where}: expected a length above 0, got {length}.")
        ends = (whole_number(first, row.where), whole_number(second, row.where))
        if ends[0] == ends[1]:
            raise InputError(f"{row.where}: expected two different ends, got {ends[0]} twice.")
        before = seen.setdefault(frozenset(ends), row.where)
        if before != row.where:
            raise InputError(
                f"{row.where}: expected each length once; {ends[0]}-{ends[1]} is that of {before}."
            )
        found.append(CalibratedLength(ends=ends, length_mm=float(length)))
    return found
