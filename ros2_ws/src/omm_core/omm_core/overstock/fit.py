"""From measured points and CAD to a placement with overstock, uncertainty and verdicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.part import Target
from omm_core.files.points import SurveyPoint, SurveyPoints
from omm_core.overstock.assignment import Points, Pose
from omm_core.overstock.choice import Choice, choose
from omm_core.overstock.face import Face
from omm_core.overstock.face_groups import group_faces
from omm_core.overstock.fit_file import FitFile
from omm_core.overstock.problem import FEWEST, Problem, Settled, least_squares, settle
from omm_core.overstock.remedies import find_remedies
from omm_core.overstock.uncertainty import Uncertainty, draw, targets_covariance
from omm_core.overstock.verdicts import describe, document, pose_json

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fit's answer.

    Attributes
    ----------
    document : dict
        What --json writes.
    problem, settled : Problem, Settled
        What was fitted, and how it lies.
    choice : Choice
        All placements that fit as well.
    targets, covariance_mm2 : tuple of Target, (3T, 3T) array or None
        Of part.yaml.
    """

    document: dict[str, Any]
    problem: Problem
    settled: Settled
    choice: Choice
    targets: tuple[Target, ...]
    covariance_mm2: Array | None

    @property
    def box_mm(self) -> Array:
        """Return the CAD's lowest and highest corner (2, 3), part frame."""
        corners = [np.stack([face.index.low, face.index.high]) for face in self.problem.faces]
        return np.stack([np.min(corners, axis=(0, 1)), np.max(corners, axis=(0, 1))])


def fit_part(faces: tuple[Face, ...], file: FitFile, survey: SurveyPoints) -> Fit:
    """Return the placement of the ideal part in the raw one.

    Raises
    ------
    InputError
        Where the start is contradictory or too few points lie on the part.
    """
    problem = Problem(
        faces=faces, groups=group_faces(faces, file), file=file, points=_plain(survey, file)
    )
    findings: list[str] = []
    choice = choose(problem, survey, findings)
    return _answer(problem, survey, choice, findings)


def fit_placed(problem: Problem, survey: SurveyPoints, pose: Pose) -> Fit:
    """Return the fit of a problem that begins at a placement part_T_survey.

    Raises
    ------
    InputError
        Where too few points lie on the part there.
    """
    return _answer(problem, survey, Choice(settled=(settle(problem, pose),), taken=0), [])


def _answer(problem: Problem, survey: SurveyPoints, choice: Choice, findings: list[str]) -> Fit:
    file, settled = problem.file, choice.settled[choice.taken or 0]
    if file.criterion == "least_squares":
        settled = least_squares(problem, settled)
        findings.append("least_squares is for comparison: it does not look at the allowances")
    coded = [point for point in survey.points if point.id is not None]
    uncertainty = draw(problem, settled, survey, coded)
    if uncertainty is None:
        findings.append("no point has a sigma: overstock counts as exact")
    elif any(survey.points[n].covariance_mm2 is None for n in range(len(survey.points))):
        findings.append("points without sigma count as exact")
    lacking = settled.placement.smallest_mm < -1e-6 and file.criterion == "even"
    remedies = find_remedies(problem, settled) if lacking else None
    describe(problem, settled, remedies, findings)
    _describe_choice(choice, survey, findings)
    result = document(problem, settled, uncertainty, remedies, findings)
    if len(choice.settled) > 1:
        result["placements"] = [_placement_json(s) for s in choice.settled]
    targets, covariance = _targets(survey, coded, settled, uncertainty)
    return Fit(
        document=result,
        problem=problem,
        settled=settled,
        choice=choice,
        targets=targets,
        covariance_mm2=covariance,
    )


def _plain(survey: SurveyPoints, file: FitFile) -> Points:
    plain = [point for point in survey.points if point.id is None]
    if len(plain) < FEWEST:
        raise InputError(f"Expected {FEWEST} or more plain points, got {len(plain)}.")
    known = {point.name for point in plain}
    for key, names in (("keep", file.keep), ("leave_out", file.leave_out)):
        missing = [name for name in names if name not in known]
        if missing:
            raise InputError(f"{key}: the points file has no plain point {', '.join(missing)}.")
    none = np.full(3, np.nan)
    return Points(
        names=tuple(point.name for point in plain),
        xyz=np.array([point.xyz_mm for point in plain]),
        normals=np.array([none if p.normal is None else p.normal for p in plain]),
    )


def _placement_json(settled: Settled) -> dict[str, Any]:
    return {
        "part_T_survey": pose_json(settled.placement.pose),
        "minimum_margin_mm": settled.placement.smallest_mm,
        "points": len(settled.points.names),
        "misfit_mm": settled.misfit_mm,
    }


def _describe_choice(choice: Choice, survey: SurveyPoints, findings: list[str]) -> None:
    if len(choice.settled) < 2:
        return
    for number, settled in enumerate(choice.settled, start=1):
        rotation, translation = settled.placement.pose
        places = [
            f"{p.name} at ({' '.join(f'{v:.0f}' for v in rotation @ p.xyz_mm + translation)})"
            for p in [p for p in survey.points if p.id is not None][:3]
        ]
        findings.append(
            f"placement {number} of {len(choice.settled)}: smallest margin"
            f" {settled.placement.smallest_mm:.3f} mm; {', '.join(places) or 'no coded target'}"
        )
    if choice.taken is not None:
        findings.append(f"placement {choice.taken + 1} is taken, as asked for")


def _targets(
    survey: SurveyPoints,
    coded: list[SurveyPoint],
    settled: Settled,
    uncertainty: Uncertainty | None,
) -> tuple[tuple[Target, ...], Array | None]:
    """Return the coded targets in the part frame and their covariance with the fit's."""
    if not coded:
        return (), None
    rotation, translation = settled.placement.pose
    places = np.array([point.xyz_mm for point in coded]) @ rotation.T + translation
    covariance = None
    if uncertainty is not None:
        covariance = targets_covariance(uncertainty, settled, survey, coded)
    sigma = None
    if covariance is not None:
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, 3)
    targets = tuple(
        Target(
            id=point.id or 0,
            xyz_mm=places[i],
            dot_diameter_mm=survey.coded_dot_diameter_mm,
            normal=None if point.normal is None else rotation @ point.normal,
            sigma_xyz_mm=None if sigma is None else sigma[i],
        )
        for i, point in enumerate(coded)
    )
    return targets, covariance
