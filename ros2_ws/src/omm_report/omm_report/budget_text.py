"""A budget as people read it in a terminal: µm, one table a thing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.box_map import BoxMap
from omm_core.budget.budget import GROUPS, Budget
from omm_core.budget.evaluation import root_sum_squares
from omm_core.budget.surface_map import SurfaceMap

if TYPE_CHECKING:
    from omm_runs.what_if import WhatIf

Array = NDArray[np.float64]


def budget_lines(
    budget: Budget, box_map: BoxMap, helps: Sequence[WhatIf], surface: SurfaceMap | None = None
) -> list[str]:
    """Return the tables of a budget: points, the worst one's contributors, the part, what helps."""
    over = map_rows(box_map) + ([] if surface is None else surface_rows(surface))
    return [
        *_point_lines(budget),
        "",
        *_worst_lines(budget),
        "",
        *("".join(f"{cell:<24}" for cell in row).rstrip() for row in over),
        "",
        *verdict_lines(budget),
        *(f"U there falls by {one.gain:5.1%} with {one.what}" for one in helps),
        *(f"note: {words}." for words in budget.findings),
    ]


def map_rows(box_map: BoxMap) -> list[list[str]]:
    """Return U_total over the part's box for each machine axis, µm, and where it is largest."""
    rows = [["over the box, µm", "smallest", "mean", "largest", "at x y z, mm (part)"]]
    for name, low, mean, high, place in box_map.table():
        cells = [f"{1e3 * value:.1f}" for value in (low, mean, high)]
        rows.append([f"U {name}", *cells, " ".join(f"{v:g}" for v in place)])
    return rows


def surface_rows(surface: SurfaceMap) -> list[list[str]]:
    """Return U_total over the CAD for each machine axis, µm, and where it is largest."""
    rows = [["over the CAD, µm", "smallest", "mean", "largest", "at x y z, mm (part), on"]]
    for row in surface.table():
        cells = [f"{1e3 * v:.1f}" for v in (row.smallest_mm, row.mean_mm, row.largest_mm)]
        place = " ".join(f"{v:.6g}" for v in row.worst_xyz_mm + 0.0)
        rows.append([f"U {row.axis}", *cells, f"{place}, {row.worst_face}"])
    return rows


def verdict_lines(budget: Budget) -> list[str]:
    """Return what U means for the tolerance, and whether Monte Carlo agrees."""
    lines = []
    judged = budget.capability()
    if judged is not None:
        ratios = ", ".join(f"{axis} {v:.1%}" for axis, v in zip("XYZ", judged.u_over_t))
        lines += [
            f"T = {judged.tolerance_mm:g} mm: U/T {ratios}: {judged.verdict}"
            " (Berndt: at most 20 %)",
            "ISO 14253-1: proven to conform within "
            + ", ".join(
                f"{axis} ±{v:.3f} mm" if v >= 0.0 else f"{axis} nothing"
                for axis, v in zip("XYZ", judged.accept_within_mm)
            ),
        ]
    lines += decision_lines(budget)
    agrees = budget.sampled.agrees.all()
    gum = budget.sampled.first_order_mm
    off = np.abs(budget.sampled.half_width_mm - gum) / np.where(gum > 0.0, gum, 1.0)
    lines.append(
        f"Monte Carlo ({budget.sampled.trials} trials) "
        + ("agrees with the GUM" if agrees else "does not agree with the GUM")
        + f" within half of u's second digit (JCGM 101, 8); U differs by up to {off.max():.1%}"
        + ("" if agrees else ": use Monte Carlo's U")
    )
    return lines


def decision_lines(budget: Budget) -> list[str]:
    """Return ISO 14253-1's decision on each deviation that was measured."""
    lines = []
    for index, point in enumerate(budget.points):
        decided = budget.decision(index)
        if decided is not None and point.deviation_mm is not None:
            each = ", ".join(
                f"{axis} {d:+.3f} mm {words} ({p:.1%})"
                for axis, d, p, words in zip("XYZ", point.deviation_mm, *decided)
            )
            lines.append(f"ISO 14253-1, {point.name}: {each}")
    return lines


def _point_lines(budget: Budget) -> list[str]:
    width = max(12, *(len(point.name) for point in budget.points))
    lines = [
        f"{'µm':<{width}}  {'U_OMM':^26}  {'U_total':^26}  {'U Monte Carlo':^26}",
        f"{'':<{width}}  " + "  ".join("".join(f"{a:>8} " for a in "XYZ")[:-1] for _ in range(3)),
    ]
    for index, point in enumerate(budget.points):
        columns = (budget.expanded_omm_mm, budget.expanded_mm, budget.sampled.half_width_mm)
        cells = "  ".join(" ".join(f"{1e3 * v:8.1f}" for v in c[index]) for c in columns)
        mark = "  worst" if index == budget.worst[0] else ""
        lines.append(f"{point.name:<{width}}  {cells}{mark}")
    return lines


def _worst_lines(budget: Budget) -> list[str]:
    point, axis = budget.worst
    lines = [
        f"{budget.points[point].name}, standard uncertainties in µm, share of the variance along"
        f" {'XYZ'[axis]}"
    ]
    width = max(20, *(len(name) for name in budget.shares()))
    for name, share in budget.shares().items():
        if name in GROUPS:
            value = root_sum_squares(budget.contributions, name)[point]
        else:
            one = next(c for c in budget.contributions if c.name == name)
            value = np.abs(one.millimetres[point])
        cells = " ".join(f"{1e3 * v:8.2f}" for v in value)
        lines.append(f"  {name:<{width}} {cells} {share:8.1%}")
    u = " ".join(f"{1e3 * v:8.2f}" for v in budget.combined.standard_uncertainty_mm[point])
    lines.append(f"  {'u, all together':<{width}} {u}")
    return lines
