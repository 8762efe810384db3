"""A probing check as people read it, and as --json writes it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from omm_core.budget.probing import COVERAGE, ProbingCheck

EXPECTED_SHARE = math.erf(math.sqrt(2.0))
_MOTION = ("about_x_rad", "about_y_rad", "about_z_rad", "x_mm", "y_mm", "z_mm")


def probing_lines(check: ProbingCheck) -> list[str]:
    """Return errors with U, how many are inside, and what they have in common."""
    rows = point_rows(check)
    width = max(len(row[0]) for row in rows)
    lines = [f"{row[0]:<{width}}" + "".join(f"{cell:>10}" for cell in row[1:]) for row in rows]
    return [*lines, "", *summary_lines(check)]


def point_rows(check: ProbingCheck) -> list[list[str]]:
    """Return a row for each touch: error and U along X Y Z, mm; a star: outside."""
    rows = [["mm", "X", "Y", "Z", "U X", "U Y", "U Z", ""]]
    for index, point in enumerate(check.points):
        cells = [f"{v:+.4f}" for v in check.error_mm[index]]
        cells += [f"{COVERAGE * v:.4f}" for v in check.sigma_mm[index]]
        rows.append([point.name, *cells, "" if check.inside[index].all() else "outside"])
    return rows


def summary_lines(check: ProbingCheck) -> list[str]:
    """Return what all errors together say."""
    error = check.error_mm
    lines = [
        f"{check.share_inside:.1%} of {error.size} coordinates inside U ({EXPECTED_SHARE:.1%}"
        " expected; they are not independent: one pose moves them all)",
        "mean "
        + _axes(error.mean(axis=0), "+.4f")
        + ", rms "
        + _axes(np.sqrt(np.mean(error**2, axis=0)), ".4f")
        + f", largest {np.abs(error).max():.4f} mm",
    ]
    if len(error) > 1:
        lines.append("2σ of the errors " + _axes(2.0 * error.std(axis=0, ddof=1), ".4f") + " mm")
    if check.believed is not None:
        lines.append(
            f"{'Believed' if check.believed else 'NOT believed'}: the uncertainty of pose and"
            f" points (χ² = {check.chi_square:.1f} with {error.size}, p = {check.p_value:.2g})"
        )
    if check.motion is not None and check.left_mm is not None:
        lines.append(
            "As one motion of the part: turned "
            + _axes(1e3 * check.motion[:3], "+.4f")
            + " mm/m, moved "
            + _axes(check.motion[3:], "+.4f")
            + " mm at the points' centre; left, rms "
            + _axes(check.left_mm, ".4f")
            + " mm"
        )
    return [*lines, *(f"note: {words}." for words in check.findings)]


def probing_dict(check: ProbingCheck) -> dict[str, Any]:
    """Return what ``probe --json`` writes."""
    error = check.error_mm
    known = check.believed is not None
    return {
        "points": [
            {
                "name": point.name,
                "part_mm": point.part_mm.tolist(),
                "probed_mm": [] if point.machine_mm is None else point.machine_mm.tolist(),
                "expected_mm": check.expected_mm[index].tolist(),
                "error_mm": error[index].tolist(),
                "sigma_mm": check.sigma_mm[index].tolist(),
                "U_mm": (COVERAGE * check.sigma_mm[index]).tolist(),
                "inside": [bool(v) for v in check.inside[index]],
            }
            for index, point in enumerate(check.points)
        ],
        "share_inside_U": check.share_inside,
        "expected_share": EXPECTED_SHARE,
        "mean_mm": error.mean(axis=0).tolist(),
        "rms_mm": np.sqrt(np.mean(error**2, axis=0)).tolist(),
        "two_sigma_mm": ((2.0 * error.std(axis=0, ddof=1)).tolist() if len(error) > 1 else None),
        "largest_mm": float(np.abs(error).max()),
        "chi_square": check.chi_square if known else None,
        "p_value": check.p_value if known else None,
        "believed": check.believed,
        "motion": (
            None
            if check.motion is None
            else {name: float(v) for name, v in zip(_MOTION, check.motion)}
        ),
        "rms_left_mm": None if check.left_mm is None else check.left_mm.tolist(),
        "findings": list(check.findings),
    }


def _axes(values: np.ndarray, form: str) -> str:
    return " ".join(f"{axis} {v:{form}}" for axis, v in zip("XYZ", values))
