"""A plan as people read it on the screen."""

from __future__ import annotations

import math

import numpy as np

from omm_core.planning.plan import Plan
from omm_core.planning.words import noise_words


def plan_text(plan: Plan) -> str:
    """Return the table of stops, the uncertainty, the time and the findings."""
    return "\n".join(
        [*_stops(plan), "", *_uncertainty(plan), "", *_elsewhere(plan), "", *_findings(plan)]
    )


def _stops(plan: Plan) -> list[str]:
    axes = plan.scene.kinematics.axes
    units = {axis.name: ("°" if axis.rotary else "mm") for axis in axes}
    lines = ["stop  " + "".join(f"{f'{n} {u}':>12}" for n, u in units.items()) + "  targets"]
    for number, stop in enumerate(plan.stops, start=1):
        places = "".join(
            f"{math.degrees(stop.axes[a.name]) if a.rotary else stop.axes[a.name]:12.3f}"
            for a in axes
        )
        lines.append(f"{number:4d}  {places}  {', '.join(map(str, stop.target_ids))}")
    return lines


def _uncertainty(plan: Plan) -> list[str]:
    U = plan.expanded_uncertainty
    angles, places = 1e3 * U[:3], U[3:6]
    return [
        f"{len(plan.stops)} images, {plan.seconds:.0f} s; {noise_words(plan.scene.noise)}",
        "U (k = 2, the machine's own coordinates):"
        f" x {places[0]:.4f}, y {places[1]:.4f}, z {places[2]:.4f} mm;"
        f" α {angles[0]:.4f}, β {angles[1]:.4f}, γ {angles[2]:.4f} mm/m;"
        f" γ_s {1e3 * U[6]:.4f} mm/m",
        f"U of the worst corner of the part's box: {plan.corner_U_mm.max():.4f} mm",
        "Smallest bump that is noticed: "
        + ", ".join(
            f"target {target} {f'{mm:.3f} mm' if np.isfinite(mm) else 'none'}"
            for target, mm in plan.bumps_mm.items()
        ),
    ]


def _elsewhere(plan: Plan) -> list[str]:
    lines = ["Where the part lies elsewhere   views left   U of the worst corner   camera to box"]
    for place in plan.elsewhere:
        U = place.worst_corner_U_mm
        told = f"{U:.4f} mm" if np.isfinite(U) else "not determined"
        lines.append(
            f"{place.words:30}  {place.seen:4d} of {place.planned:3d}   {told:21}"
            f"   {place.clearance_mm:6.0f} mm"
        )
    return lines


def _findings(plan: Plan) -> list[str]:
    return [f"note: {finding}" for finding in plan.findings]
