"""A fit as a document: verdict, table of faces, colour map, what was left out, what if."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from omm_core.overstock.fit import Fit
from omm_core.overstock.what_if import WhatIf, rows_of
from omm_report.document import Document
from omm_report.fit_map import map_of_fit
from omm_report.fit_picture import overstock_figure

HEAD = ["faces", "points", "smallest", "U", "mean", "largest", "required", "verdict"]


def fit_document(fit: Fit, source: str, what_if: WhatIf | None = None) -> bytes:
    """Return the PDF of a fit.

    Parameters
    ----------
    fit : Fit
    source : str
        The fit file, as people named it.
    what_if : WhatIf or None
        Another fit with changed allowances, to be set beside.
    """
    result = fit.document
    document = Document(f"Fit of {fit.problem.file.cad.name}")
    document.paragraph(f"From {source}.\n{verdict_words(result)}")
    document.heading("Overstock by face")
    document.paragraph(
        "mm; material outside the nominal face at the measured points, foil taken off. U of the"
        " smallest: 95.45 % of errors are smaller."
    )
    document.table(group_rows(result["groups"]), widths=[3.4, 0.8, 1.0, 0.8, 0.9, 0.9, 1.0, 1.2])
    document.figure(
        overstock_figure(map_of_fit(fit)),
        caption="Overstock on the part; between points by inverse square distance.",
    )
    if what_if is not None:
        document.heading("What if")
        document.paragraph(what_if.words)
        document.table(rows_of(fit, what_if), widths=[3.4, 1.1, 1.1, 1.2, 1.2])
        document.figure(overstock_figure(map_of_fit(what_if.fit)), caption="After the change.")
    if result["findings"]:
        document.heading("Findings")
        document.paragraph("\n".join(f"· {words}." for words in result["findings"]))
    document.attach(
        "fit.json",
        json.dumps(result, allow_nan=False).encode(),
        description="the result as written by --json",
        mime_type="application/json",
    )
    return document.to_bytes()


def verdict_words(result: dict[str, Any]) -> str:
    """Return the outcome in one sentence."""
    if result["minimum_margin_mm"] is None:
        return "No face is to be milled: the datum faces alone place the part."
    known = result["minimum_margin_U_mm"]
    doubt = "U not known" if known is None else f"U {known:.3f} mm"
    limits = " and ".join(result["limiting"]) or "nothing"
    if not result["feasible"]:
        return (
            f"No placement leaves enough material: {result['missing_mm']:.3f} mm are missing"
            f" between {limits} (best smallest margin {result['minimum_margin_mm']:.3f} mm,"
            f" {doubt})."
        )
    held = "" if result["determined"] else " The placement is not determined: see the findings."
    return (
        f"There is enough material where it was measured: smallest margin"
        f" {result['minimum_margin_mm']:.3f} mm, {doubt}; limited by {limits}.{held}"
    )


def group_rows(groups: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Return the table of faces."""

    def number(value: float | None) -> str:
        return "–" if value is None else f"{value:.3f}"

    keys = ("minimum_mm", "minimum_U_mm", "mean_mm", "maximum_mm", "required_mm")
    return [HEAD] + [
        [row["name"], str(row["points"]), *(number(row[key]) for key in keys), row["verdict"]]
        for row in groups
    ]
