"""The placement to go on with: told, or looked for; where several fit as well, it asks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.points import SurveyPoints
from omm_core.overstock.problem import Problem, Settled, settle
from omm_core.overstock.search import search_placements
from omm_core.overstock.start import best_rotation, told_places, told_start, unit_words

Array = NDArray[np.float64]
# A placement fits as well as the best where it leaves out no more points and
# its overstock varies no more.
AS_WELL_TIMES = 1.25
AS_WELL_MM = 0.1
LEFT_OUT_SHARE = 0.03
SAME_SHARE = 0.03
ALIKE_MM = 0.5
WILD_MM = 30.0
WILD_SHARE = 0.04
SIZE_RATIO = (0.15, 6.0)
ROUGHLY = 0.5
FEW_SHARE = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Choice:
    """The placements that fit as well as each other, and which is taken: None where to ask."""

    settled: tuple[Settled, ...]
    taken: int | None


def choose(problem: Problem, file_points: SurveyPoints, findings: list[str]) -> Choice:
    """Return the placements that fit, settled.

    Raises
    ------
    InputError
        Where nothing fits, or the start is contradictory.
    """
    start = told_start(problem.file, file_points, findings)
    if start is not None:
        settled = settle(problem, start)
        _check_believable(problem, settled, file_points)
        return Choice(settled=(settled,), taken=0)
    _check_size(problem)
    found = _searched(problem)
    if not found:
        raise InputError(
            "No placement was found in which the points lie on the part. Give a start: 3 or more"
            " pairs of a point and about where it is on the CAD."
        )
    equal = _as_good(found, file_points, problem)
    number = problem.file.placement
    if number is not None and number > len(equal):
        raise InputError(f"placement: expected 1 to {len(equal)}, got {number}.")
    if number is None and len(equal) == 1:
        number = 1
        findings.append("the placement was looked for and found: one fits, and no other as well")
    taken = None if number is None else number - 1
    _check_believable(problem, equal[taken or 0], file_points)
    return Choice(settled=tuple(equal), taken=taken)


def _searched(problem: Problem) -> list[Settled]:
    """Return the placements that are found without being told, the best first."""
    found: list[Settled] = []
    for pose in search_placements(problem.faces, problem.points):
        try:
            settled = settle(problem, pose)
        except InputError:
            continue  # nothing lies on the part from there: no placement
        same = [n for n, other in enumerate(found) if _alike(problem, settled, other)]
        if not same:
            found.append(settled)
        elif _rank(problem, settled) < _rank(problem, found[same[0]]):
            found[same[0]] = settled
    return sorted(found, key=lambda settled: _rank(problem, settled))


def _as_good(found: list[Settled], survey: SurveyPoints, problem: Problem) -> list[Settled]:
    """Return those that fit as well as the best, in an order that does not depend on chance."""
    least = min(_rank(problem, s)[0] for s in found)
    few = [s for s in found if _rank(problem, s)[0] <= least + LEFT_OUT_SHARE]
    best = min(s.misfit_mm for s in few)
    good = [s for s in few if s.misfit_mm <= AS_WELL_TIMES * best + AS_WELL_MM]
    measured, wanted = told_places(problem.file, survey)
    if len(measured):
        off = [_pairs_off(s, measured, wanted) for s in good]
        good = [s for s, d in zip(good, off) if d < 2.0 * min(off) + 10.0]
    return sorted(good, key=lambda s: tuple(np.round(-s.placement.rotation.ravel(), 3)))


def _pairs_off(settled: Settled, measured: Array, wanted: Array) -> float:
    rotation, translation = settled.placement.pose
    return float(np.linalg.norm(measured @ rotation.T + translation - wanted, axis=1).max())


def _alike(problem: Problem, a: Settled, b: Settled) -> bool:
    """Return whether two placements are one: near, or turned about the axis of a turned part."""
    if _apart(problem, a, b) < SAME_SHARE:
        return True
    if not len(a.placement.free) or not np.array_equal(a.face, b.face):
        return False
    apart = np.abs(a.placement.overstock_mm - b.placement.overstock_mm)
    return bool(a.points.names == b.points.names and apart.max() < ALIKE_MM)


def _apart(problem: Problem, a: Settled, b: Settled) -> float:
    """Return how far apart two placements are, as a share of the part's size."""
    placed = [problem.points.placed(s.placement.pose)[0] for s in (a, b)]
    return float(np.abs(placed[0] - placed[1]).max()) / _diagonal(problem.points.xyz)


def _rank(problem: Problem, settled: Settled) -> tuple[float, float]:
    """Return the share of points left out and the misfit: the less, the better it fits."""
    return len(settled.left_out) / len(problem.points.names), settled.misfit_mm


def _check_size(problem: Problem) -> None:
    corners = np.concatenate([face.triangles.reshape(-1, 3) for face in problem.faces])
    ratio = _diagonal(problem.points.xyz) / _diagonal(corners)
    if SIZE_RATIO[0] < ratio < SIZE_RATIO[1]:
        return
    told = unit_words(ratio, ROUGHLY)
    raise InputError(
        f"The points are {told or f'{ratio:.3g} times as large as the CAD'}. Give both in mm"
        " (cad_unit for STL and PLY)."
    )


def _diagonal(places: Array) -> float:
    arms = places - places.mean(axis=0)
    return float(np.sqrt((arms**2).sum(axis=1).mean()))


def _check_believable(problem: Problem, settled: Settled, survey: SurveyPoints) -> None:
    """Refuse where the points do not lie on the part, and say why if that can be told."""
    total = len(problem.points.names) - len(problem.file.leave_out)
    on = len(settled.points.names)
    size = _diagonal(problem.points.xyz)
    if on >= FEW_SHARE * total and settled.misfit_mm < max(WILD_MM, WILD_SHARE * size):
        return
    why = []
    if problem.file.pairs or problem.file.nominal_targets:
        for other in _searched(problem)[:1]:
            if 3.0 * other.misfit_mm < settled.misfit_mm:
                why.append(
                    "Without the pairs there is a placement that fits: the pairs (or nominal"
                    " targets) name wrong points or places."
                )
    if _mirrored_fits(problem, survey):
        why.append("The mirror image of the points fits: an axis may have the wrong sign.")
    raise InputError(
        f"Where the fit begins, {on} of {total} points lie on the part, and their overstock"
        f" varies by {settled.misfit_mm:.0f} mm rms."
        f" {' '.join(why) or 'Check pairs, unit and CAD.'}"
    )


def _mirrored_fits(problem: Problem, survey: SurveyPoints) -> bool:
    from dataclasses import replace

    flip = np.diag([1.0, 1.0, -1.0])
    points = replace(
        problem.points, xyz=problem.points.xyz @ flip, normals=problem.points.normals @ flip
    )
    mirrored = replace(problem, points=points)
    measured, wanted = told_places(problem.file, survey)
    try:
        if len(measured) >= 3:
            pose, _ = best_rotation(measured @ flip, wanted)
            poses = [pose]
        else:
            poses = search_placements(mirrored.faces, points)[:2]
        shares = [len(settle(mirrored, pose).points.names) for pose in poses]
    except InputError:
        return False
    return max(shares, default=0) > 0.8 * len(points.names)
