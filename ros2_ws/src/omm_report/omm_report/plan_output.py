"""What a plan leaves behind: JSON, program, picture, document."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omm_core.files.output import write_whole
from omm_core.planning.other_programs import program_text
from omm_core.planning.plan import Plan
from omm_core.planning.plan_file import program_json
from omm_core.planning.plan_program import plan_program
from omm_core.planning.program import Program


@dataclass(frozen=True, kw_only=True)
class PlanOutputs:
    """Files to be written, None where not wanted, and how the program is to be."""

    json: Path | None = None
    program: Path | None = None
    picture: Path | None = None
    report: Path | None = None
    control: str = "linuxcnc"
    limit_mm: float = 50.0
    search_mm: float | None = None


def write_plan(plan: Plan, outputs: PlanOutputs) -> None:
    """Write the files; the program only where the plan reaches what was wished.

    Raises
    ------
    InputError
        Where a file cannot be written, or the control has no such program.
    """
    program = _program(plan, outputs) if plan.reached else None
    content = plan.to_json()
    if program is not None:
        content["program"] = program_json(plan, program)
    # The text first: a control that there is not shall leave nothing behind.
    text = "" if program is None else program_text(program, outputs.control)
    if outputs.json is not None:
        write_json(content, outputs.json)
    if outputs.program is not None and text:
        write_whole(outputs.program, text)
    if outputs.picture is not None:
        from omm_report.plan_picture import save_plan_picture

        save_plan_picture(plan, outputs.picture)
    if outputs.report is not None:
        from omm_report.plan_report import save_plan_report

        save_plan_report(plan, outputs.report)


def write_no_plan(why: str, path: Path) -> None:
    """Write the JSON of where there is no stop at all."""
    nothing = {"covariance": None, "expanded_uncertainty": None}
    content = {"stops": [], "predicted": nothing, "seconds": 0.0, "findings": [why]}
    write_json(content, path)


def write_json(content: dict[str, Any], path: Path) -> None:
    """Write plain JSON, numbers as they are."""
    write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def _program(plan: Plan, outputs: PlanOutputs) -> Program:
    if outputs.search_mm is None:
        return plan_program(plan, limit_mm=outputs.limit_mm)
    return plan_program(plan, limit_mm=outputs.search_mm, search=True)
