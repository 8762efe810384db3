"""A pose, given or out of a recording, in a control's own words."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omm_core.alignment.handover import (
    DEFAULT_BOX,
    Box,
    Handover,
    box_of,
    box_of_targets,
    hand_over,
)
from omm_core.errors import InputError, MeasurementError
from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.session.quantities import THETA
from omm_recording.run_files import find_run
from omm_runs.solving import SolveRunOptions, solve_run


@dataclass(frozen=True, kw_only=True)
class HandoverOptions:
    """What to hand over: a recording or θ (α, β, γ in rad, x, y, z in mm); to whom, and how."""

    run: Path | None
    theta: tuple[float, ...] | None
    part_file: Path | None
    calibration_file: Path | None
    machine_file: Path | None
    control: str
    offset: str | None
    remaining_mm: float


def handover_of(options: HandoverOptions) -> Handover:
    """Return the file for the control.

    Raises
    ------
    InputError
        Where the options or the files cannot be used.
    MeasurementError
        Where the recording has no result, or the control cannot say the pose.
    """
    if (options.run is None) == (options.theta is None):
        raise InputError("Expected either RUN or --theta.")
    if options.theta is not None:
        theta, box, title = options.theta, DEFAULT_BOX, "pose as given"
    else:
        assert options.run is not None  # one of the two is there
        theta, part = _measured(options, options.run)
        box = _box_beside(options.run) or box_of_targets(part)
        title = f"pose of the recording {options.run.name}"
    if not all(math.isfinite(value) for value in theta):
        raise InputError(f"Expected finite numbers for --theta, got {theta}.")
    return hand_over(
        RigidTransform.from_euler_xyz_rad(theta[0], theta[1], theta[2], theta[3:6]),
        options.control,
        offset=options.offset,
        box=box if options.part_file is None else box_of(options.part_file),
        remaining_mm=options.remaining_mm,
        title=title,
    )


def _box_beside(run: Path) -> Box | None:
    """Return the box of the part file beside a recording, None where it lies inside."""
    beside = find_run(run).beside("part.yaml")
    return None if beside is None else box_of(beside)


def _measured(options: HandoverOptions, run: Path) -> tuple[tuple[float, ...], Part]:
    chosen: dict[str, Any] = {
        "part_file": options.part_file,
        "calibration_file": options.calibration_file,
    }
    if options.machine_file is not None:
        chosen["machine_file"] = options.machine_file
    solved = solve_run(run, SolveRunOptions(**chosen))
    result = solved.result
    if not result.determined or result.solution is None or not result.solution.converged:
        reasons = "; ".join([*result.missing, *result.findings])
        raise MeasurementError(f"{run} has no pose to hand over: {reasons or 'not converged'}.")
    theta = result.to_json_dict()["theta"]
    return tuple(theta[quantity.key] for quantity in THETA[:6]), solved.part
