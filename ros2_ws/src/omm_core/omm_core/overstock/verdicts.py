"""What a fit says: fit --json, and its findings in words."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import euler_xyz_rad_from_rotation
from omm_core.overstock.assignment import Pose
from omm_core.overstock.motions import loose_motions, motion_words
from omm_core.overstock.problem import Problem, Settled
from omm_core.overstock.remedies import Remedies
from omm_core.overstock.uncertainty import Uncertainty

Array = NDArray[np.float64]
LIMITS = 1e-6
ENOUGH_MM = 1e-6
MOST_BARE = 20


def document(
    problem: Problem,
    settled: Settled,
    uncertainty: Uncertainty | None,
    remedies: Remedies | None,
    findings: list[str],
) -> dict[str, Any]:
    """Return what ``fit --json`` holds."""
    placement, groups = settled.placement, settled.wish.groups
    names = [group.name for group in problem.groups.asked]
    weights = np.bincount(groups, placement.limiting, minlength=len(names))
    everything = ~settled.wish.is_aside
    feasible = placement.smallest_mm >= -ENOUGH_MM and placement.breach_mm <= ENOUGH_MM
    missing = 0.0
    if remedies is not None:
        # One allowance of those that limit, lowered alone: the whole of what is missing there.
        missing = -placement.smallest_mm / max(float(weights.max()), LIMITS)
    return {
        "feasible": bool(feasible),
        "determined": not loose_motions(problem.faces, placement)[0],
        "part_T_survey": pose_json(placement.pose),
        "points": _points(settled, names, uncertainty),
        "groups": [
            _group(problem, settled, uncertainty, number)
            for number in range(len(names))
            if (groups == number).any()
        ],
        "minimum_margin_mm": placement.smallest_mm if everything.any() else None,
        "minimum_margin_U_mm": uncertainty.expanded(everything) if uncertainty else None,
        "limiting": [names[n] for n in np.argsort(-weights, kind="stable") if weights[n] > LIMITS],
        "missing_mm": missing,
        "remedies": _remedies_json(remedies, names),
        "breach_mm": placement.breach_mm,
        "left_out": [{"name": n, "reason": why} for n, why in settled.left_out.items()],
        "findings": findings,
    }


def pose_json(pose: Pose) -> dict[str, list[float]]:
    """Return a pose as translation and Euler angles."""
    return {
        "translation_mm": [float(v) for v in pose[1]],
        "euler_xyz_rad": [float(v) for v in euler_xyz_rad_from_rotation(pose[0])],
    }


def _points(
    settled: Settled, names: list[str], uncertainty: Uncertainty | None
) -> list[dict[str, Any]]:
    return [
        {
            "name": name,
            "group": names[settled.wish.groups[i]],
            "overstock_mm": float(settled.placement.overstock_mm[i]),
            "sigma_mm": float(uncertainty.sigma_mm[i]) if uncertainty else None,
        }
        for i, name in enumerate(settled.points.names)
    ]


def _group(
    problem: Problem, settled: Settled, uncertainty: Uncertainty | None, number: int
) -> dict[str, Any]:
    on = settled.wish.groups == number
    asked = problem.groups.asked[number]
    overstock = settled.placement.overstock_mm[on]
    row: dict[str, Any] = {
        "name": asked.name,
        "points": int(on.sum()),
        "minimum_mm": float(overstock.min()),
        "mean_mm": float(overstock.mean()),
        "maximum_mm": float(overstock.max()),
        "required_mm": asked.minimum_mm,
        "verdict": "enough",
    }
    if asked.maximum_mm is not None:
        row["allowed_mm"] = asked.maximum_mm
    aside = settled.wish.is_aside[on].all()
    half = uncertainty.expanded(on) if uncertainty and not aside else 0.0
    row["minimum_U_mm"] = half if uncertainty and not aside else None
    if asked.datum_mm is not None:
        # A datum is there to locate: that it lies at its stock is what it was fitted to.
        row["required_mm"] = asked.datum_mm
        return row
    if asked.minimum_mm is None:
        row["verdict"] = "not milled"
        return row
    room = float(overstock.min()) - asked.minimum_mm
    if asked.maximum_mm is not None:
        room = min(room, asked.maximum_mm - float(overstock.max()))
    row["verdict"] = verdict(room, half)
    return row


def verdict(room_mm: float, expanded_mm: float) -> str:
    """Return the state of a margin with U."""
    if room_mm >= expanded_mm - ENOUGH_MM:
        return "enough"
    return "too little" if room_mm < -expanded_mm - ENOUGH_MM else "not proven"


def _remedies_json(remedies: Remedies | None, names: list[str]) -> dict[str, Any] | None:
    if remedies is None:
        return None
    return {
        "alone": [{"group": names[g], "lower_by_mm": v} for g, v in remedies.alone.items()],
        "least": [{"group": names[g], "lower_by_mm": v} for g, v in remedies.least.items()],
    }


def describe(
    problem: Problem, settled: Settled, remedies: Remedies | None, findings: list[str]
) -> None:
    """Add what people must know to the findings."""
    for name, why in settled.left_out.items():
        findings.append(f"point {name} is left out: {why}")
    _describe_faces(problem, settled, findings)
    harmful, harmless = loose_motions(problem.faces, settled.placement)
    for motion in harmful:
        findings.append(
            f"nothing holds {motion_words(motion, settled.placement)} (part frame): the placement"
            " stays there as the start has it. Measure points on a face that stops it, or give"
            " one that lies across a datum_overstock_mm"
        )
    for motion in harmless:
        findings.append(
            f"the part is symmetric: {motion_words(motion, settled.placement)} changes no"
            " overstock, and the start decides"
        )
    if settled.placement.breach_mm > ENOUGH_MM:
        findings.append(
            "the limits (maximum, tolerance between groups) contradict each other or the"
            f" material: broken by {settled.placement.breach_mm:.3f} mm at least"
        )
    if remedies is not None:
        _describe_lack(problem, settled, remedies, findings)


def _describe_faces(problem: Problem, settled: Settled, findings: list[str]) -> None:
    seen = set(settled.wish.groups.tolist())
    bare = [g.name for n, g in enumerate(problem.groups.asked) if n not in seen]
    for name in bare[:MOST_BARE]:
        findings.append(f"no point on {name}: its overstock is not known")
    if len(bare) > MOST_BARE:
        findings.append(f"no point on {len(bare) - MOST_BARE} more faces, either")
    for number in np.unique(settled.face):
        face = problem.faces[number]
        if face.kind == "free":
            chord = "an error that the file does not tell"
            if np.isfinite(face.chord_mm):
                chord = f"an error of up to about {face.chord_mm:.3f} mm"
            findings.append(f"{face.name} is taken as its triangles: its overstock has {chord}")


def _describe_lack(
    problem: Problem, settled: Settled, remedies: Remedies, findings: list[str]
) -> None:
    names = [group.name for group in problem.groups.asked]
    placement, groups = settled.placement, settled.wish.groups
    weights = np.bincount(groups, placement.limiting, minlength=len(names))
    weights = weights / max(weights.sum(), 1e-12)
    sum_words = " + ".join(
        f"{weights[n]:.3f} x margin of {names[n]}" for n in np.flatnonzero(weights > LIMITS)
    )
    findings.append(
        f"no placement helps: wherever the part lies, {sum_words} is not more than"
        f" {placement.smallest_mm:.3f} mm (to first order)"
    )
    for n in np.unique(groups):
        on = (groups == n) & np.isfinite(placement.margins_mm)
        if on.any() and placement.margins_mm[on].min() < -ENOUGH_MM:
            low = placement.margins_mm[on].min()
            findings.append(f"{names[n]} lacks {-low:.3f} mm in the best placement")
    for n, by in remedies.alone.items():
        findings.append(f"{names[n]}: alone, its allowance would have to be lowered by {by:.3f} mm")
    if len(remedies.least) > 1:
        least = " and ".join(f"{by:.3f} mm on {names[n]}" for n, by in remedies.least.items())
        findings.append(f"the least to give up in all, {remedies.sum_mm:.3f} mm: {least}")
