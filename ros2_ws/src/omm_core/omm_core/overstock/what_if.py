"""What if an allowance were another: the same points fitted again, before and after."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from omm_core.errors import InputError
from omm_core.files.points import SurveyPoints
from omm_core.overstock.fit import Fit, fit_placed


@dataclass(frozen=True, kw_only=True, eq=False)
class WhatIf:
    """The fit with changed allowances, and the change in words."""

    words: str
    fit: Fit


def parse_changes(texts: list[str]) -> dict[str, float]:
    """Return changes of allowances by group, mm, from words like ``base=-0.5``.

    Raises
    ------
    InputError
        Where a text is not a name with a number.
    """
    changes: dict[str, float] = {}
    for text in texts:
        name, mark, value = text.rpartition("=")
        try:
            change = float(value)
        except ValueError:
            change = float("nan")
        if not mark or not name.strip() or not np.isfinite(change):
            raise InputError(f"--what-if: expected GROUP=MM, such as base=-0.5, got '{text}'.")
        changes[name.strip()] = change
    return changes


def what_if(fit: Fit, survey: SurveyPoints, changes: dict[str, float]) -> WhatIf:
    """Fit again with allowances changed by so many mm, from where the fit lies.

    Raises
    ------
    InputError
        Where a group is not there, ambiguous, or not milled.
    """
    groups = list(fit.problem.groups.asked)
    words = []
    for name, change in changes.items():
        number = _number(fit, name)
        minimum = groups[number].minimum_mm
        if minimum is None:
            raise InputError(f"--what-if: '{groups[number].name}' is not milled.")
        groups[number] = replace(groups[number], minimum_mm=minimum + change)
        words.append(f"{groups[number].name}: {minimum:.3f} to {minimum + change:.3f} mm")
    changed = replace(fit.problem.groups, asked=tuple(groups))
    problem = replace(fit.problem, groups=changed)
    return WhatIf(
        words=f"Allowance of {'; '.join(words)}.",
        fit=fit_placed(problem, survey, fit.settled.placement.pose),
    )


def _number(fit: Fit, name: str) -> int:
    names = [group.name for group in fit.problem.groups.asked]
    if name in names:
        return names.index(name)
    found = [n for n, other in enumerate(names) if name in other]
    if name.isdigit() and 1 <= int(name) <= len(fit.problem.faces):
        found = [int(fit.problem.groups.of_face[int(name) - 1])]
    if len(found) != 1:
        raise InputError(
            f"--what-if: expected the name of one group (or a part of it), or a face's number,"
            f" got '{name}'; there are {', '.join(names)}."
        )
    return found[0]


def rows_of(before: Fit, after: WhatIf) -> list[list[str]]:
    """Return a table: each group's smallest overstock and verdict, before and after."""
    rows = [["faces", "before", "after", "verdict before", "after"]]
    later = {row["name"]: row for row in after.fit.document["groups"]}
    for row in before.document["groups"]:
        other = later.get(row["name"])
        if other is not None:
            numbers = [f"{r['minimum_mm']:.3f}" for r in (row, other)]
            rows.append([row["name"], *numbers, row["verdict"], other["verdict"]])
    margins = [f"{d['minimum_margin_mm']:.3f}" for d in (before.document, after.fit.document)]
    feasible = [
        "enough" if d["feasible"] else "too little" for d in (before.document, after.fit.document)
    ]
    return [*rows, ["smallest margin", *margins, *feasible]]
