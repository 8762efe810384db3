"""Faces that belong together, and what each group is asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.overstock.face import Face
from omm_core.overstock.fit_file import FaceGroup, FitFile
from omm_core.overstock.wish import Balance, Wish

Array = NDArray[np.float64]
SAME_MM = 1e-2
SAME_DIRECTION = 1e-5
LIKE_DIRECTION = 0.02
LIKE_MM = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Groups:
    """All groups of a part.

    Attributes
    ----------
    asked : tuple of FaceGroup
        Name and limits of each.
    of_face : (F,) array of int
        Group of each face.
    balances : tuple of Balance
        Tolerances between groups.
    """

    asked: tuple[FaceGroup, ...]
    of_face: NDArray[np.int64]
    balances: tuple[Balance, ...]

    def wish(self, faces_of_points: NDArray[np.int64]) -> Wish:
        """Return what is asked of points on these faces (N,)."""
        groups = self.of_face[faces_of_points]
        none = [g.minimum_mm is None for g in self.asked]
        required = np.array([-np.inf if n else g.minimum_mm for g, n in zip(self.asked, none)])
        maximum = np.array([np.inf if g.maximum_mm is None else g.maximum_mm for g in self.asked])
        datum = np.array([np.nan if g.datum_mm is None else g.datum_mm for g in self.asked])
        return Wish(
            groups=groups,
            required_mm=required[groups],
            maximum_mm=maximum[groups] if np.isfinite(maximum).any() else None,
            datum_mm=None if np.isnan(datum).all() else datum[groups],
            datum_rank=groups,
            balances=self.balances,
        )


def group_faces(faces: tuple[Face, ...], file: FitFile) -> Groups:
    """Return the groups of fit.yaml, then one for each surface that is in none.

    Raises
    ------
    InputError
        Where a group chooses no face, or two groups choose the same.
    """
    of = np.full(len(faces), -1, dtype=np.int64)
    asked: list[FaceGroup] = []
    for group in file.groups:
        chosen = _chosen(faces, group)
        taken = [n for n in chosen if of[n] >= 0]
        if taken:
            raise InputError(
                f"groups: face {taken[0] + 1} ({faces[taken[0]].name}) is in"
                f" '{asked[of[taken[0]]].name}' and in '{group.name}'; it can be in one."
            )
        of[chosen] = len(asked)
        asked.append(group)
    for number, face in enumerate(faces):
        if of[number] >= 0:
            continue
        same = [k for k in range(number, len(faces)) if of[k] < 0 and _same(face, faces[k])]
        of[same] = len(asked)
        taken_names = {group.name for group in asked}
        name = face.name if face.name not in taken_names else f"{face.name} (face {number + 1})"
        asked.append(FaceGroup(name=name, minimum_mm=file.minimum_overstock_mm))
    return Groups(asked=tuple(asked), of_face=of, balances=_balances(asked, file))


def _balances(asked: list[FaceGroup], file: FitFile) -> tuple[Balance, ...]:
    names = [group.name for group in asked]
    for tolerance in file.tolerances:
        for name in tolerance.groups:
            if name not in names:
                raise InputError(
                    f"tolerances: expected the name of a group, got '{name}'; there are"
                    f" {', '.join(names)}."
                )
    return tuple(
        Balance(
            first=names.index(tolerance.groups[0]),
            second=names.index(tolerance.groups[1]),
            low_mm=tolerance.low_mm,
            high_mm=tolerance.high_mm,
        )
        for tolerance in file.tolerances
    )


def _chosen(faces: tuple[Face, ...], group: FaceGroup) -> list[int]:
    wrong = sorted(n for n in group.faces if not 1 <= n <= len(faces))
    if wrong:
        raise InputError(f"groups: the CAD has faces 1 to {len(faces)}, got {wrong}.")
    chosen = {n - 1 for n in group.faces}
    if group.chooses:
        chosen |= {n for n, face in enumerate(faces) if _matches(face, group)}
    if not chosen:
        raise InputError(
            f"groups: '{group.name}' chooses no face. ./omm fit --faces lists them with kind,"
            " normal, offset, colour and label."
        )
    return sorted(chosen)


def _matches(face: Face, group: FaceGroup) -> bool:
    if group.kind is not None and face.kind != group.kind:
        return False
    if group.normal is not None:
        apart = np.linalg.norm(face.axis - group.normal)
        if face.kind != "plane":
            apart = min(apart, np.linalg.norm(face.axis + group.normal))
        if apart > LIKE_DIRECTION:
            return False
    offset = face.axis @ face.origin
    if group.offset_mm is not None and (
        face.kind != "plane" or abs(offset - group.offset_mm) > LIKE_MM
    ):
        return False
    if group.radius_mm is not None and abs(face.radius_mm - group.radius_mm) > LIKE_MM:
        return False
    if group.colour is not None and face.colour.lower() != group.colour.lower():
        return False
    return group.label is None or face.label == group.label


def _same(a: Face, b: Face) -> bool:
    """Return whether two faces lie on one surface, to be milled in one go."""
    if a.kind != b.kind or a.sign != b.sign or a.label != b.label or a.colour != b.colour:
        return a is b
    sizes = (a.radius_mm - b.radius_mm, a.ring_radius_mm - b.ring_radius_mm)
    if a.kind == "free" or max(map(abs, sizes)) > SAME_MM:
        return a is b
    arm = b.origin - a.origin
    if a.kind == "sphere":
        return bool(np.linalg.norm(arm) < SAME_MM)
    along = a.axis @ b.axis
    if a.kind == "plane":
        return bool(along > 1.0 - SAME_DIRECTION and abs(arm @ a.axis) < SAME_MM)
    if abs(along) < 1.0 - SAME_DIRECTION or abs(a.half_angle_rad - b.half_angle_rad) > 1e-4:
        return a is b
    if a.kind == "cylinder":
        arm = arm - (arm @ a.axis) * a.axis
    return bool(np.linalg.norm(arm) < SAME_MM)
