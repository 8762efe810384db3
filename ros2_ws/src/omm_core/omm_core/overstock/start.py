"""Where to begin: from pairs of points, or from coded targets with nominal places."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.points import SurveyPoints
from omm_core.overstock.fit_file import FitFile

Array = NDArray[np.float64]
Pose = tuple[Array, Array]
FEWEST_PAIRS = 3
THIN = 0.02
WRONG_TIMES = 4.0
WRONG_MM = 30.0
MIRRORED_TIMES = 5.0
KNOWN_FACTORS = {
    25.4: "25.4 times larger: one of both is in inch",
    1.0 / 25.4: "25.4 times smaller: one of both is in inch",
    1000.0: "1000 times larger: one of both is in m",
    1e-3: "1000 times smaller: one of both is in m",
    10.0: "10 times larger: one of both is in cm",
    0.1: "10 times smaller: one of both is in cm",
}
FACTOR = 0.08


def told_start(file: FitFile, survey: SurveyPoints, findings: list[str]) -> Pose | None:
    """Return part_T_survey from pairs and nominal targets; None where they do not suffice.

    Raises
    ------
    InputError
        Where a point is not there, or the pairs contradict each other, are mirrored, or in
        another unit.
    """
    names, measured, wanted = _pairs(file, survey)
    if len(names) < FEWEST_PAIRS or _in_line(wanted) or _in_line(measured):
        if names:
            findings.append(
                f"the {len(names)} pair(s) do not tell a placement (3 that are not in one line"
                " do): the placement is looked for"
            )
        return None
    _check_unit(measured, wanted)
    pose, residual = best_rotation(measured, wanted)
    worst = float(residual.max())
    if len(names) > FEWEST_PAIRS and worst > WRONG_MM:
        pose, out = _without_one(measured, wanted, pose, residual)
        if out is not None:
            findings.append(f"pair {names[out]} does not fit the others: left out of the start")
    _, residual = _at(pose, measured, wanted)
    _check_mirror(measured, wanted, float(np.sqrt((residual**2).mean())))
    return pose


def told_places(file: FitFile, survey: SurveyPoints) -> tuple[Array, Array]:
    """Return measured (N, 3) and wanted (N, 3) places of all pairs, to choose placements by."""
    _, measured, wanted = _pairs(file, survey)
    return measured, wanted


def _pairs(file: FitFile, survey: SurveyPoints) -> tuple[list[str], Array, Array]:
    by_name = {str(p.id): p for p in survey.points if p.id is not None}
    by_name.update({point.name: point for point in survey.points})
    missing = [name for name in file.pairs if name not in by_name]
    if missing:
        raise InputError(f"pairs: the points file has no point {', '.join(missing)}.")
    wanted = dict(file.pairs)
    by_id = {p.id: p for p in survey.points if p.id is not None}
    for number, xyz in file.nominal_targets.items():
        if number in by_id:
            wanted.setdefault(by_id[number].name, xyz)
    if file.nominal_targets and not set(file.nominal_targets) & set(by_id):
        raise InputError(
            "nominal_targets: none of them is in the points file, which has the coded targets"
            f" {sorted(by_id)}."
        )
    measured = np.array([by_name[name].xyz_mm for name in wanted]).reshape(-1, 3)
    return list(wanted), measured, np.array(list(wanted.values())).reshape(-1, 3)


def best_rotation(measured: Array, wanted: Array, *, mirrored: bool = False) -> tuple[Pose, Array]:
    """Return the rigid motion of the best fit (Kabsch) and each pair's distance after it."""
    a, b = measured - measured.mean(axis=0), wanted - wanted.mean(axis=0)
    left, _, right = np.linalg.svd(b.T @ a)
    sign = np.sign(np.linalg.det(left) * np.linalg.det(right))
    turn = np.ones(3)
    turn[2] = -sign if mirrored else sign
    rotation = left @ np.diag(turn) @ right
    return _at((rotation, wanted.mean(axis=0) - rotation @ measured.mean(axis=0)), measured, wanted)


def _at(pose: Pose, measured: Array, wanted: Array) -> tuple[Pose, Array]:
    return pose, np.linalg.norm(measured @ pose[0].T + pose[1] - wanted, axis=1)


def _in_line(places: Array) -> bool:
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(spread[1] < THIN * spread[0])


def _without_one(
    measured: Array, wanted: Array, pose: Pose, residual: Array
) -> tuple[Pose, int | None]:
    """Leave out the one pair without which the others fit much better."""
    best: tuple[float, Pose, int] | None = None
    for out in range(len(measured)):
        rest = np.arange(len(measured)) != out
        if _in_line(wanted[rest]) or _in_line(measured[rest]):
            continue
        trial, left = best_rotation(measured[rest], wanted[rest])
        if best is None or left.max() < best[0]:
            best = (float(left.max()), trial, out)
    if best is None or best[0] * WRONG_TIMES > residual.max():
        return pose, None
    return best[1], best[2]


def _check_unit(measured: Array, wanted: Array) -> None:
    pairs = list(itertools.combinations(range(len(measured)), 2))
    ratios = [
        np.linalg.norm(measured[i] - measured[j])
        / max(float(np.linalg.norm(wanted[i] - wanted[j])), 1e-9)
        for i, j in pairs
    ]
    told = unit_words(float(np.median(ratios)))
    if told:
        raise InputError(f"pairs: distances between the points are {told}. Give both in mm.")


def unit_words(ratio: float, doubt: float = FACTOR) -> str:
    """Return what a ratio of lengths (points by CAD) says of a wrong unit; empty where nothing."""
    for factor, words in KNOWN_FACTORS.items():
        if abs(ratio / factor - 1.0) < doubt:
            return f"{words} (points by CAD: {ratio:.4g})"
    return ""


def _check_mirror(measured: Array, wanted: Array, rms: float) -> None:
    _, residual = best_rotation(measured, wanted, mirrored=True)
    other = float(np.sqrt((residual**2).mean()))
    if rms > WRONG_MM and other * MIRRORED_TIMES < rms:
        raise InputError(
            f"pairs: the points fit the CAD as its mirror image ({other:.1f} mm) and not as they"
            f" are ({rms:.1f} mm). An axis of the points or of the CAD has the wrong sign."
        )
