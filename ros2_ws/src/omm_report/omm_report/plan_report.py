"""A plan as a document to be stapled to the inspection plan."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from omm_core.files.output import write_whole
from omm_core.planning.plan import Plan
from omm_core.planning.words import noise_words
from omm_report.document import Document
from omm_report.plan_picture import plan_figure


def save_plan_report(plan: Plan, path: Path) -> None:
    """Write the plan as PDF; the same plan gives the same bytes."""
    document = Document(f"Measuring plan: {plan.scene.part.name}")
    document.paragraph(
        f"Machine {plan.scene.kinematics.name}, camera {plan.scene.calibration.name}."
        f" {len(plan.stops)} images, {plan.seconds:.0f} s."
        f" Taken as: {noise_words(plan.scene.noise)}."
    )
    caption = "The part's box, its targets, and where the camera stops."
    document.figure(plan_figure(plan), caption=caption)
    document.heading("Expected uncertainty")
    document.table(_uncertainty(plan))
    document.paragraph(
        "In the machine's own coordinates: where this machine mills or probes the part."
    )
    document.heading("Stops")
    document.table(_stops(plan))
    document.heading("Where the part lies elsewhere")
    document.table(_elsewhere(plan))
    document.heading("Bumps")
    document.table(_bumps(plan))
    document.heading("Findings")
    for finding in plan.findings:
        document.paragraph(finding)
    write_whole(path, document.to_bytes())


def _uncertainty(plan: Plan) -> list[list[str]]:
    U = plan.expanded_uncertainty
    return [
        ["", "U (k = 2)"],
        *[[name, f"{1e3 * u:.4f} mm/m"] for name, u in zip("αβγ", U[:3])],
        *[[name, f"{u:.4f} mm"] for name, u in zip("xyz", U[3:6])],
        ["γ_s", f"{1e3 * U[6]:.4f} mm/m"],
        ["worst corner of the part's box", f"{plan.corner_U_mm.max():.4f} mm"],
    ]


def _stops(plan: Plan) -> list[list[str]]:
    axes = plan.scene.kinematics.axes
    rows = [["stop", *[f"{a.name} {'°' if a.rotary else 'mm'}" for a in axes], "targets"]]
    for number, stop in enumerate(plan.stops, start=1):
        values = [math.degrees(stop.axes[a.name]) if a.rotary else stop.axes[a.name] for a in axes]
        targets = ", ".join(map(str, stop.target_ids))
        rows.append([str(number), *[f"{value:.3f}" for value in values], targets])
    return rows


def _elsewhere(plan: Plan) -> list[list[str]]:
    rows = [["part", "views left", "U of the worst corner", "camera to box"]]
    for place in plan.elsewhere:
        U = place.worst_corner_U_mm
        told = f"{U:.4f} mm" if np.isfinite(U) else "not determined"
        clear = f"{place.clearance_mm:.0f} mm"
        rows.append([place.words, f"{place.seen} of {place.planned}", told, clear])
    return rows


def _bumps(plan: Plan) -> list[list[str]]:
    rows = [["target", "smallest displacement that is noticed"]]
    for target, mm in plan.bumps_mm.items():
        rows.append([str(target), f"{mm:.3f} mm" if np.isfinite(mm) else "none"])
    return rows
