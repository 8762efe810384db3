"""One fit: the points that count, each on its face, and the placement that does best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.overstock.assignment import (
    Points,
    Pose,
    assign,
    off_the_part,
    outliers,
    without_doubt,
)
from omm_core.overstock.face import Face
from omm_core.overstock.face_groups import Groups
from omm_core.overstock.fit_file import FitFile
from omm_core.overstock.placement import place_by_least_squares, place_evenly
from omm_core.overstock.placement_state import Placement
from omm_core.overstock.wish import Wish

Array = NDArray[np.float64]
FEWEST = 6
ROUNDS = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """What is fitted to what.

    Attributes
    ----------
    faces, groups : of the CAD
    file : FitFile
        What is asked for.
    points : Points
        All plain points.
    """

    faces: tuple[Face, ...]
    groups: Groups
    file: FitFile
    points: Points

    def surfaces(self, face: NDArray[np.int64], placed: Array) -> tuple[Array, Array]:
        """Return how far each place (N, 3) is outside its face (N,), and the normals."""
        distance, normals = np.empty(len(placed)), np.empty_like(placed)
        for number in np.unique(face):
            on = face == number
            distance[on], normals[on] = self.faces[number].distance(placed[on])
        return distance, normals

    def place(self, settled: NDArray[np.int64], points: Points, pose: Pose) -> Placement:
        """Place points on known faces evenly."""
        return place_evenly(
            points.xyz,
            lambda placed: self.surfaces(settled, placed),
            self.groups.wish(settled),
            thickness_mm=self.file.target_thickness_mm,
            rotation=pose[0],
            translation_mm=pose[1],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Settled:
    """Points on their faces, placed.

    Attributes
    ----------
    points : Points
        Those that count.
    face : (N,) array of int
        The face of each.
    wish : Wish
        What is asked of them.
    placement : Placement
        The best.
    left_out : dict
        Why, by name.
    """

    points: Points
    face: NDArray[np.int64]
    wish: Wish
    placement: Placement
    left_out: dict[str, str]

    @property
    def misfit_mm(self) -> float:
        """Return how much the overstock varies over the part, rms: small where the fit is right."""
        return float(self.placement.overstock_mm.std())


def settle(problem: Problem, pose: Pose) -> Settled:
    """Place until all points keep their faces; leave out, with the reason, what lies on none.

    Raises
    ------
    InputError
        Where fewer than 6 points lie on the part.
    """
    points, keep = problem.points, np.isin(problem.points.names, problem.file.keep)
    barred: dict[int, str] = {
        n: "named under leave_out"
        for n, name in enumerate(points.names)
        if name in problem.file.leave_out
    }
    previous: NDArray[np.int64] | None = None
    for _ in range(ROUNDS):
        given = assign(problem.faces, points, pose)
        given = without_doubt(problem.faces, given, points.placed(pose)[0])
        reasons = _reasons(problem, given.face, given.distance, off_the_part(given), pose)
        for n in np.flatnonzero(given.other >= 0).tolist():
            reasons.setdefault(n, "two faces are as near, and it has no normal")
        reasons = {n: why for n, why in reasons.items() if not (keep[n] and given.face[n] >= 0)}
        reasons.update(barred)
        used = np.array([n not in reasons for n in range(len(points.names))])
        if used.sum() < FEWEST:
            raise InputError(
                f"Only {used.sum()} of {len(used)} points lie on the part where the fit begins;"
                f" {FEWEST} are needed. Check pairs, unit and CAD."
            )
        face = np.where(used, given.face, -1)
        strange = _outliers(problem, face, used & ~keep, pose)
        if strange:
            barred.update(strange)
            previous = None
            continue
        if previous is not None and np.array_equal(face, previous):
            break
        previous = face
        placement = problem.place(face[used], points.only(used), pose)
        pose = placement.pose
    names = np.array(points.names)
    return Settled(
        points=points.only(used),
        face=face[used],
        wish=problem.groups.wish(face[used]),
        placement=placement,
        left_out={str(names[n]): why for n, why in sorted(reasons.items())},
    )


def _reasons(
    problem: Problem, face: NDArray[np.int64], distance: Array, off: NDArray[np.bool_], pose: Pose
) -> dict[int, str]:
    reasons: dict[int, str] = {}
    placed, _ = problem.points.placed(pose)
    for n in np.flatnonzero(off).tolist():
        at = " ".join(f"{v:.1f}" for v in placed[n])
        if face[n] < 0:
            reasons[n] = f"no face near ({at}) looks its way"
        else:
            reasons[n] = (
                f"at ({at}) it is {distance[n]:.1f} mm from the nearest face that looks its way"
            )
    return reasons


def _outliers(
    problem: Problem, face: NDArray[np.int64], used: NDArray[np.bool_], pose: Pose
) -> dict[int, str]:
    placed, _ = problem.points.placed(pose)
    rows = np.flatnonzero(face >= 0)
    off = np.zeros(len(face))
    off[rows] = outliers(problem.faces, face[rows], placed[rows])
    words: dict[int, str] = {}
    for n in np.flatnonzero((off != 0.0) & used).tolist():
        way = "deeper than" if off[n] < 0.0 else "above"
        words[n] = (
            f"it lies {abs(off[n]):.1f} mm {way} what the others on"
            f" {problem.faces[face[n]].name} tell; if the surface is so, name it under keep"
        )
    return words


def least_squares(problem: Problem, settled: Settled) -> Settled:
    """Return the best fit of the same points: for comparison."""
    placement = settled.placement
    pose = place_by_least_squares(
        settled.points.xyz,
        lambda placed: problem.surfaces(settled.face, placed),
        rotation=placement.rotation,
        translation_mm=placement.translation_mm,
    )
    distance, _ = problem.surfaces(settled.face, settled.points.placed(pose)[0])
    overstock = distance - problem.file.target_thickness_mm
    margins = np.where(settled.wish.is_aside, np.inf, overstock - settled.wish.required_mm)
    fitted = replace(
        placement,
        rotation=pose[0],
        translation_mm=pose[1],
        overstock_mm=overstock,
        margins_mm=margins,
        limiting=(margins == margins.min()).astype(float),
    )
    return replace(settled, placement=fitted)
