"""What the machine adds to a budget where the tool goes: as declared, else as the run shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.evaluation import Contribution, standard
from omm_core.budget.machine import geometry_left_mm
from omm_core.files.machine import MachineUncertainty
from omm_core.geometry import RigidTransform
from omm_runs.solving import SolvedRun

Array = NDArray[np.float64]

_KEYS = ("stop_sigma_mm", "geometry_sigma_mm", "geometry_length_mm")


def machine_contribution(
    machine: MachineUncertainty,
    run: SolvedRun | None,
    machine_T_part: RigidTransform,
    xyz_mm: Array,
    tool_mm: Array,
) -> tuple[Contribution, list[str]]:
    """Return u_machine: one more stop, and the geometry beyond what the pose took in.

    Parameters
    ----------
    xyz_mm : (P, 3) array
        Part frame.
    tool_mm : (3,) array
        From the spindle to the tool's tip, machine axes.
    """
    findings = []
    stop = np.full(xyz_mm.shape, machine.stop_sigma_mm or 0.0)
    geometry = np.full(xyz_mm.shape, machine.geometry_sigma_mm or 0.0)
    if np.any(geometry > 0.0) and run is not None and machine.geometry_length_mm:
        stops, seen = _stops(run, machine_T_part)
        sigma, length = float(geometry[0, 0]), machine.geometry_length_mm
        at = machine_T_part @ xyz_mm
        geometry = geometry_left_mm(sigma, length, stops, seen, at, tool_mm)
        if not np.any(tool_mm):
            findings.append(
                "u_machine: tool_mm (spindle to tool's tip, machine axes) is not given and counts"
                " as 0"
            )
    elif np.any(geometry > 0.0):
        findings.append("u_machine: without a run the geometry counts in full at each point")
    contribution = Contribution(
        name="u_machine",
        group="u_machine",
        millimetres=np.hypot(stop, geometry),
        shape=standard("normal"),
    )
    return contribution, findings


def as_estimated(
    declared: MachineUncertainty, run: SolvedRun | None
) -> tuple[MachineUncertainty, list[str]]:
    """Return what is declared of the machine, and for the rest what the run shows."""
    missing = [key for key in _KEYS if getattr(declared, key) is None]
    if declared.geometry_sigma_mm == 0.0 and missing == ["geometry_length_mm"]:
        return declared, []
    if not missing:
        return declared, []
    words = " and ".join(missing)
    shown = run.result.solution.machine if run is not None else None
    if shown is None:
        return declared, [f"u_machine: {words} not declared; what it makes counts as 0"]
    taken = {key: getattr(shown, key).median for key in missing}
    return (
        replace(declared, **taken),
        [f"u_machine: {words} not declared, taken as the run shows"],
    )


def _stops(
    run: SolvedRun, machine_T_part: RigidTransform
) -> tuple[Array, list[tuple[Array, list[int]]]]:
    """Return the stops' places, and for each target seen its place and the stops that saw it."""
    solution = run.result.solution
    used = [o for o, use in zip(solution.observations, solution.used) if use]
    stamps = sorted({o.stamp_ns for o in used})
    place = {o.stamp_ns: o.machine_T_spindle.translation_mm for o in used}
    seen = []
    for target in run.part.targets:
        stops = [stamps.index(o.stamp_ns) for o in used if o.target_id == target.id]
        if stops:
            seen.append((machine_T_part @ target.xyz_mm, stops))
    return np.array([place[stamp] for stamp in stamps]), seen
