"""Budgets, campaigns and probing checks as documents to be stapled to the inspection plan."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from omm_core.budget.box_map import BoxMap
from omm_core.budget.budget import GROUPS, Budget
from omm_core.budget.campaign import Campaign
from omm_core.budget.evaluation import root_sum_squares
from omm_core.budget.probing import ProbingCheck
from omm_core.budget.surface_map import SurfaceMap
from omm_report.budget_figures import campaign_figure, map_figure, probing_figure, shares_figure
from omm_report.budget_surface_picture import surface_figure
from omm_report.budget_text import map_rows, surface_rows, verdict_lines
from omm_report.campaign_text import (
    analysis_rows,
    campaign_dict,
    headline,
    two_sigma_rows,
)
from omm_report.campaign_text import verdict_lines as campaign_verdicts
from omm_report.document import Document
from omm_report.probing_text import point_rows, probing_dict, summary_lines

if TYPE_CHECKING:
    from omm_runs.what_if import WhatIf


def budget_document(
    budget: Budget,
    box_map: BoxMap,
    helps: Sequence[WhatIf],
    source: str,
    surface: SurfaceMap | None = None,
) -> bytes:
    """Return the PDF of a budget."""
    document = Document("Uncertainty budget")
    document.paragraph(
        f"From {source}. U of the machine coordinates of points of the part, along machine X Y Z."
    )
    document.heading("Verdict")
    for line in verdict_lines(budget):
        document.paragraph(line)
    document.heading("Points")
    document.table(_point_rows(budget), widths=(2.4, *[1.0] * 9))
    document.heading("Contributors")
    document.table(_contributor_rows(budget), widths=(2.6, 1.2, 1.1, 0.9, 0.9, 0.9, 0.9))
    document.figure(shares_figure(budget), width_mm=130.0)
    document.heading("Over the part")
    document.table(map_rows(box_map))
    document.figure(map_figure(box_map), caption="U_total over the part's box; cross: the worst.")
    if surface is not None:
        document.table(surface_rows(surface), widths=(1.2, 0.8, 0.8, 0.8, 3.4))
        document.figure(surface_figure(surface), caption="U_total over the CAD; cross: the worst.")
    document.heading("What would help")
    document.table(
        [["done better, all else as it is", "U at the worst point falls by"]]
        + [[one.what, f"{one.gain:.1%}"] for one in helps]
    )
    _notes(document, budget.findings)
    _attach(document, "budget.json", budget.to_json_dict())
    return document.to_bytes()


def campaign_document(campaign: Campaign, source: str, *, beside_paper: bool = False) -> bytes:
    """Return the PDF of a campaign."""
    document = Document("Campaign: repeatability, reproducibility, capability")
    document.paragraph(f"From {source}: {headline(campaign)}.")
    document.heading("Twice the standard deviations of all measurements")
    widths = (2.2, *[1.0] * 7)
    document.table(two_sigma_rows(campaign, beside_paper=beside_paper), widths=widths)
    document.heading("Analysis of variance")
    document.table(
        analysis_rows(campaign), widths=(0.6, 0.9, 1.1, 1.2, 1.2, 1.3, 0.9, 0.8, 0.8, 0.9)
    )
    for line in campaign_verdicts(campaign):
        document.paragraph(line)
    what = "Errors" if campaign.measured[0].truth is not None else "Deviations from the mean"
    document.figure(
        campaign_figure(campaign), caption=f"{what} by clamping; band: ± 2 σ as predicted."
    )
    _attach(document, "campaign.json", campaign_dict(campaign))
    return document.to_bytes()


def probing_document(check: ProbingCheck, source: str) -> bytes:
    """Return the PDF of a probing check."""
    document = Document("Probed points against the part's pose")
    document.paragraph(f"Pose of {source}. Errors are probed minus expected, machine X Y Z.")
    for line in summary_lines(check):
        document.paragraph(line)
    document.figure(probing_figure(check), caption="Errors (dots) and U (bars); red: outside.")
    document.heading("Touches")
    document.table(point_rows(check), widths=(2.0, *[1.0] * 7))
    _attach(document, "probing.json", probing_dict(check))
    return document.to_bytes()


def _point_rows(budget: Budget) -> list[list[str]]:
    heads = ("U_OMM", "U_total", "U Monte Carlo")
    rows = [["µm", *(f"{head} {axis}" for head in heads for axis in "XYZ")]]
    columns = (budget.expanded_omm_mm, budget.expanded_mm, budget.sampled.half_width_mm)
    for index, point in enumerate(budget.points):
        cells = [f"{1e3 * v:.1f}" for column in columns for v in column[index]]
        worst = " (worst)" if index == budget.worst[0] else ""
        rows.append([point.name + worst, *cells])
    return rows


def _contributor_rows(budget: Budget) -> list[list[str]]:
    """Return name, distribution, degrees of freedom, u along X Y Z (µm) at the worst point."""
    point, axis = budget.worst
    rows = [["contributor", "distribution", "degrees of freedom", "u X, µm", "u Y", "u Z",
             f"share {'XYZ'[axis]}"]]  # fmt: skip
    for one in budget.contributions:
        freedom = float(one.degrees_of_freedom()[point, axis])
        cells = [f"{1e3 * abs(v):.2f}" for v in one.millimetres[point]]
        share = budget.combined.shares[one.name][point, axis]
        told = "∞" if freedom == float("inf") else f"{freedom:.1f}"
        rows.append([one.name, one.shape.kind, told, *cells, f"{share:.1%}"])
    total = [f"{1e3 * v:.2f}" for v in budget.combined.standard_uncertainty_mm[point]]
    rows.append(["u, all together", "", "", *total, "100.0%"])
    for group in GROUPS:
        several = [c for c in budget.contributions if c.group == group]
        if len(several) > 1:
            value = root_sum_squares(budget.contributions, group)[point]
            rows.append([f"of it {group}", "", "", *(f"{1e3 * v:.2f}" for v in value), ""])
    return rows


def _notes(document: Document, findings: Sequence[str]) -> None:
    if findings:
        document.heading("Notes")
        for words in findings:
            document.paragraph(f"{words}.")


def _attach(document: Document, name: str, content: dict[str, Any]) -> None:
    document.attach(
        name,
        json.dumps(content, allow_nan=False).encode(),
        description="the result as written by --json",
        mime_type="application/json",
    )
