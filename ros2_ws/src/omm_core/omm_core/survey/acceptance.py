"""Acceptance by lengths, after VDI/VDE 2634 part 1: measured against calibrated lengths.

The length measurement error of each is measured minus calibrated; its limit grows with the length:
``LME = constant + per metre · L`` (the paper: 0.05 mm + 0.02 mm/m). Believed as a rectangular
distribution, it is the standard uncertainty ``u_out = LME / sqrt(3)`` of the budget.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from omm_core.errors import MeasurementError

LENGTHS_WANTED = 35  # 7 lines of 5 lengths
LONGEST_WANTED = 2.0 / 3.0  # of the diagonal of the measured volume


@dataclass(frozen=True, kw_only=True)
class CalibratedLength:
    """A length between two coded targets, mm."""

    ends: tuple[int, int]
    length_mm: float


@dataclass(frozen=True, kw_only=True)
class LengthError:
    """What was measured of it, mm."""

    ends: tuple[int, int]
    length_mm: float
    measured_mm: float
    sigma_mm: float
    limit_mm: float

    @property
    def error_mm(self) -> float:
        """Return measured minus calibrated."""
        return self.measured_mm - self.length_mm

    @property
    def within(self) -> bool:
        """Tell whether the error keeps to the limit."""
        return abs(self.error_mm) <= self.limit_mm


@dataclass(frozen=True, kw_only=True)
class Acceptance:
    """The test as a whole."""

    lengths: tuple[LengthError, ...]
    constant_mm: float
    per_metre_mm: float
    words: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Tell whether every length keeps to its limit."""
        return all(length.within for length in self.lengths)

    @property
    def largest(self) -> LengthError:
        """Return the length with the largest error."""
        return max(self.lengths, key=lambda length: abs(length.error_mm))

    @property
    def longest_mm(self) -> float:
        """Return the longest length."""
        return max(length.length_mm for length in self.lengths)

    @property
    def u_out_mm(self) -> float:
        """Return the standard uncertainty that the limit stands for, at the longest length."""
        lme = self.constant_mm + self.per_metre_mm * self.longest_mm / 1e3
        return float(lme / np.sqrt(3.0))


def accept(
    wanted: list[CalibratedLength],
    measure: Callable[[tuple[int, int]], tuple[float, float] | None],
    diagonal_mm: float,
    constant_mm: float,
    per_metre_mm: float,
) -> Acceptance:
    """Compare lengths.

    Parameters
    ----------
    measure : callable
        Ends -> measured length and its standard deviation, None where an end was not measured.
    diagonal_mm : float
        Of the measured volume.

    Raises
    ------
    MeasurementError
        Where none of the lengths was measured.
    """
    found, missing = [], []
    for length in wanted:
        measured = measure(length.ends)
        if measured is None:
            missing.append(f"{length.ends[0]}-{length.ends[1]}")
            continue
        found.append(
            LengthError(
                ends=length.ends, length_mm=length.length_mm, measured_mm=measured[0],
                sigma_mm=measured[1], limit_mm=constant_mm + per_metre_mm * length.length_mm / 1e3,
            )
        )  # fmt: skip
    if not found:
        raise MeasurementError(
            "Expected calibrated lengths between measured targets; none of them was measured."
        )
    words = []
    if missing:
        words.append(f"Lengths not measured: {', '.join(missing)}.")
    if len(found) < LENGTHS_WANTED:
        words.append(
            f"VDI/VDE 2634-1 asks for {LENGTHS_WANTED} lengths (7 lines of 5), these are"
            f" {len(found)}: a check, not a full acceptance test."
        )
    longest = max(length.length_mm for length in found)
    if longest < LONGEST_WANTED * diagonal_mm:
        words.append(
            f"The longest length, {longest:.0f} mm, is less than two thirds of the diagonal of the"
            f" measured volume ({diagonal_mm:.0f} mm), which VDI/VDE 2634-1 asks for."
        )
    return Acceptance(
        lengths=tuple(found), constant_mm=constant_mm, per_metre_mm=per_metre_mm,
        words=tuple(words),
    )  # fmt: skip


def as_json(acceptance: Acceptance) -> dict[str, object]:
    """Return the test as ``survey --json`` says it."""
    errors = np.array([length.error_mm for length in acceptance.lengths])
    return {
        "passed": acceptance.passed,
        "LME": {"constant_mm": acceptance.constant_mm, "per_metre_mm": acceptance.per_metre_mm},
        "largest_error_mm": float(errors[np.argmax(np.abs(errors))]),
        "rms_error_mm": float(np.sqrt(np.mean(errors**2))),
        "u_out_mm": acceptance.u_out_mm,
        "lengths": [
            {
                "ends": list(length.ends), "length_mm": length.length_mm,
                "measured_mm": length.measured_mm, "error_mm": length.error_mm,
                "sigma_mm": length.sigma_mm, "limit_mm": length.limit_mm, "within": length.within,
            }
            for length in acceptance.lengths
        ],
    }  # fmt: skip
