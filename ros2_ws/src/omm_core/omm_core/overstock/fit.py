"""From measured points and CAD to a placement with overstock, uncertainty and verdicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.errors import InputError
from omm_core.files.part import Target
from omm_core.files.points import SurveyPoint, SurveyPoints
from omm_core.geometry import RigidTransform
from omm_core.overstock.cad import Face
from omm_core.overstock.fit_file import FitFile
from omm_core.overstock.placement import Placement, place_by_least_squares, place_evenly

Array = NDArray[np.float64]
Pose = tuple[Array, Array]
DRAWS = 100
SEED = 1
COVERAGE = 0.9545
LIMITS = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fit's answer: what --json writes, and part.yaml's targets and covariance."""

    document: dict[str, Any]
    smallest_margin_uncertainty_mm: float
    targets: tuple[Target, ...]
    covariance_mm2: Array | None


class _Problem:
    """Points on raw surfaces, each with its face and group."""

    def __init__(self, faces: tuple[Face, ...], file: FitFile, points: list[SurveyPoint]) -> None:
        self.faces, self.file, self.points = faces, file, points
        self.xyz = np.array([point.xyz_mm for point in points])
        self.names, self.required, self.group_of = _groups(faces, file)
        self.face = np.zeros(len(points), dtype=int)

    def assign(self, pose: Pose) -> Array:
        """Give each point its nearest face that looks its way; return the distances."""
        placed = self.xyz @ pose[0].T + pose[1]
        cost = np.empty((len(self.faces), len(placed)))
        for number, face in enumerate(self.faces):
            places, normals = face.nearest(placed)
            cost[number] = np.linalg.norm(placed - places, axis=1)
            for i, point in enumerate(self.points):
                if point.normal is not None and (pose[0] @ point.normal) @ normals[i] < 0.7:
                    cost[number, i] = np.inf
        self.face = cost.argmin(axis=0)
        return np.asarray(cost.min(axis=0))

    def keep(self, chosen: NDArray[np.bool_]) -> None:
        """Drop points."""
        self.points = [p for p, good in zip(self.points, chosen, strict=True) if good]
        self.xyz, self.face = self.xyz[chosen], self.face[chosen]

    def surfaces(self, placed: Array) -> tuple[Array, Array]:
        """Return distance outside each point's face, and the normals."""
        distance, normals = np.empty(len(placed)), np.empty_like(placed)
        for number in np.unique(self.face):
            on = self.face == number
            distance[on], normals[on] = self.faces[number].distance(placed[on])
        return distance, normals

    def place(self, pose: Pose, xyz: Array | None = None) -> Placement:
        """Place by the file's criterion."""
        groups = self.group_of[self.face]
        xyz = self.xyz if xyz is None else xyz
        return place_evenly(
            xyz,
            self.surfaces,
            required_mm=self.required[groups],
            groups=groups,
            thickness_mm=self.file.target_thickness_mm,
            rotation=pose[0],
            translation_mm=pose[1],
        )


def fit_part(faces: tuple[Face, ...], file: FitFile, survey: SurveyPoints) -> Fit:
    """Return the placement of the ideal part in the raw one.

    Raises
    ------
    InputError
        Where no start is given or no point lies on the part.
    """
    problem = _Problem(faces, file, [p for p in survey.points if p.id is None])
    if len(problem.points) < 6:
        raise InputError(f"Expected 6 or more plain points, got {len(problem.points)}.")
    findings: list[str] = []
    pose = _start(file, survey)
    placed = _settle(problem, pose, findings)
    pose = (placed.rotation, placed.translation_mm)
    poses, draws = _draws(problem, pose, findings)
    document, uncertainty = _document(problem, placed, draws, findings)
    targets, covariance = _targets(survey, pose, poses)
    return Fit(
        document=document,
        smallest_margin_uncertainty_mm=uncertainty,
        targets=targets,
        covariance_mm2=covariance,
    )


def _groups(faces: tuple[Face, ...], file: FitFile) -> tuple[list[str], Array, NDArray[Any]]:
    """Return names, allowances and each face's group; planes in one plane are one group."""
    names: list[str] = [group.name for group in file.groups]
    required = [group.minimum_overstock_mm for group in file.groups]
    own = {n: i for i, group in enumerate(file.groups) for n in group.faces}
    wrong = sorted(n for n in own if not 1 <= n <= len(faces))
    if wrong:
        raise InputError(f"groups: the CAD has faces 1 to {len(faces)}, got {wrong}.")
    of = np.zeros(len(faces), dtype=int)
    for number, face in enumerate(faces, start=1):
        if number not in own and face.name not in names:
            names.append(face.name)
            required.append(file.minimum_overstock_mm)
        of[number - 1] = own[number] if number in own else names.index(face.name)
    return names, np.array(required), of


def _start(file: FitFile, survey: SurveyPoints) -> Pose:
    """Return part_T_survey from the pairs."""
    by_name = {point.name: point for point in survey.points}
    by_name.update({str(p.id): p for p in survey.points if p.id is not None})
    missing = [name for name in file.pairs if name not in by_name]
    if missing:
        raise InputError(f"pairs: the points file has no point {', '.join(missing)}.")
    if len(file.pairs) < 3:
        raise InputError(
            "Expected a start: 3 or more pairs of a point and about where it is on the CAD,"
            f" not in one line; got {len(file.pairs)}."
        )
    a = np.array([by_name[name].xyz_mm for name in file.pairs])
    b = np.array(list(file.pairs.values()))
    rotation, _ = Rotation.align_vectors(b - b.mean(axis=0), a - a.mean(axis=0))
    matrix = rotation.as_matrix()
    return matrix, b.mean(axis=0) - matrix @ a.mean(axis=0)


def _settle(problem: _Problem, pose: Pose, findings: list[str]) -> Placement:
    """Place until the points keep their faces; name those that lie on none."""
    for _ in range(4):
        distance = problem.assign(pose)
        limit = 30.0 + 6.0 * float(np.median(distance))
        good = distance < limit
        for point, far in zip(problem.points, distance, strict=True):
            if not far < limit:
                how = f"{far:.1f} mm off" if np.isfinite(far) else "no face looks its way"
                findings.append(f"point {point.name} lies on no face ({how}): left out")
        problem.keep(good)
        if len(problem.points) < 6:
            raise InputError("Fewer than 6 points lie on the part: check pairs, unit and CAD.")
        before = problem.face.copy()
        placed = problem.place(pose)
        pose = (placed.rotation, placed.translation_mm)
        problem.assign(pose)
        if np.array_equal(before, problem.face):
            break
    if problem.file.criterion == "least_squares":
        fitted = place_by_least_squares(
            problem.xyz, problem.surfaces, rotation=pose[0], translation_mm=pose[1]
        )
        margins = problem.surfaces(problem.xyz @ fitted[0].T + fitted[1])[0]
        margins = margins - problem.file.target_thickness_mm
        margins = margins - problem.required[problem.group_of[problem.face]]
        placed = _moved(placed, fitted, margins)
        findings.append("least_squares is for comparison: it does not look at the allowances")
    return placed


def _moved(placed: Placement, pose: Pose, margins: Array) -> Placement:
    from dataclasses import replace

    return replace(placed, rotation=pose[0], translation_mm=pose[1], margins_mm=margins)


def _draws(problem: _Problem, pose: Pose, findings: list[str]) -> tuple[list[Pose], Array]:
    """Fit again with the points' uncertainty drawn anew: poses, true margins under them."""
    known = [p.covariance_mm2 for p in problem.points]
    if any(c is None for c in known):
        findings.append("points without sigma count as exact")
    if problem.file.criterion == "least_squares" or all(c is None for c in known):
        return [], np.empty((0, len(known)))
    random = np.random.default_rng(SEED)
    roots = np.array([np.zeros((3, 3)) if c is None else _root(c) for c in known])
    offset = problem.required[problem.group_of[problem.face]] + problem.file.target_thickness_mm
    poses, margins = [], []
    for _ in range(DRAWS):
        noise = np.einsum("nij,nj->ni", roots, random.standard_normal((len(known), 3)))
        placed = problem.place(pose, problem.xyz + noise)
        drawn = (placed.rotation, placed.translation_mm)
        poses.append(drawn)
        # The measured points stand for the true ones; their noise chose the placement.
        margins.append(placed.margins_mm - _margin(problem, drawn, offset))
    return poses, np.array(margins)


def _margin(problem: _Problem, pose: Pose, offset: Array) -> Array:
    return np.asarray(problem.surfaces(problem.xyz @ pose[0].T + pose[1])[0] - offset)


def _root(covariance: Array) -> Array:
    values, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(values, 0.0)))


def _document(
    problem: _Problem, placed: Placement, errors: Array, findings: list[str]
) -> tuple[dict[str, Any], float]:
    """Return fit --json and U of the smallest margin."""
    groups = problem.group_of[problem.face]
    margins = placed.margins_mm
    overstock = margins + problem.required[groups]
    known = len(errors) > 0
    sigma = np.sqrt((errors**2).mean(axis=0)) if known else np.zeros(len(margins))

    def spread(on: NDArray[Any]) -> float:
        if not known:
            return 0.0
        # Told smallest margin minus the true one under the same placement, bias included.
        told = (margins + errors)[:, on].min(axis=1) - margins[on].min()
        return float(np.quantile(np.abs(told), COVERAGE))

    for number in np.unique(problem.face):
        if problem.faces[number].kind == "free":
            findings.append(
                f"{problem.faces[number].name} is taken as its triangles: their chord error,"
                " which the file does not tell, stands in its overstock"
            )
    rows = []
    for number, name in enumerate(problem.names):
        on = groups == number
        if not on.any():
            findings.append(f"no point on {name}: its overstock is not known")
            continue
        low, half = float(margins[on].min()), spread(on)
        verdict = "enough" if low >= half else "too little" if low < -half else "not proven"
        rows.append(
            {
                "name": name,
                "points": int(on.sum()),
                "minimum_mm": float(overstock[on].min()),
                "mean_mm": float(overstock[on].mean()),
                "maximum_mm": float(overstock[on].max()),
                "required_mm": float(problem.required[number]),
                "verdict": verdict,
            }
        )
    weights = {n: float(placed.limiting[groups == n].sum()) for n in np.unique(groups)}
    limiting = [problem.names[n] for n, w in weights.items() if w > LIMITS]
    feasible = placed.smallest_mm >= 0.0
    for motion in placed.free:
        findings.append(f"no point holds the motion {np.round(motion, 3).tolist()}")
    if not feasible and problem.file.criterion == "even":
        # One allowance alone, lowered until the smallest margin is zero: m* = sum of w m.
        for n, weight in weights.items():
            if weight > LIMITS:
                findings.append(
                    f"{problem.names[n]}: alone, its allowance would have to be lowered by"
                    f" {-placed.smallest_mm / weight:.3f} mm"
                )
    pose = RigidTransform(rotation=placed.rotation, translation_mm=placed.translation_mm)
    euler = Rotation.from_matrix(pose.rotation).as_euler("xyz")
    document = {
        "feasible": bool(feasible),
        "part_T_survey": {
            "translation_mm": pose.translation_mm.tolist(),
            "euler_xyz_rad": euler.tolist(),
        },
        "points": [
            {
                "name": point.name,
                "group": problem.names[groups[i]],
                "overstock_mm": float(overstock[i]),
                "sigma_mm": float(sigma[i]) if known else None,
            }
            for i, point in enumerate(problem.points)
        ],
        "groups": rows,
        "minimum_margin_mm": placed.smallest_mm,
        "minimum_margin_U_mm": spread(np.ones(len(margins), dtype=bool)) if known else None,
        "limiting": limiting,
        "missing_mm": max(0.0, -placed.smallest_mm),
        "findings": findings,
    }
    return document, spread(np.ones(len(margins), dtype=bool))


def _targets(
    survey: SurveyPoints, pose: Pose, poses: list[Pose]
) -> tuple[tuple[Target, ...], Array | None]:
    """Return the coded targets in the part frame and their covariance with the fit's."""
    coded = [point for point in survey.points if point.id is not None]
    if not coded:
        return (), None
    xyz = np.array([point.xyz_mm for point in coded])
    covariance = np.zeros((3 * len(coded), 3 * len(coded)))
    if poses:
        moved = np.array([(xyz @ r.T + t).ravel() for r, t in poses])
        covariance += np.cov(moved.T)
    for i, point in enumerate(coded):
        if point.covariance_mm2 is not None:
            block = slice(3 * i, 3 * i + 3)
            covariance[block, block] += pose[0] @ point.covariance_mm2 @ pose[0].T
    covariance = 0.5 * (covariance + covariance.T)
    sigma = np.sqrt(np.diag(covariance)).reshape(-1, 3)
    known = bool(sigma.any())
    targets = tuple(
        Target(
            id=point.id or 0,
            xyz_mm=pose[0] @ point.xyz_mm + pose[1],
            dot_diameter_mm=survey.coded_dot_diameter_mm,
            normal=None if point.normal is None else pose[0] @ point.normal,
            sigma_xyz_mm=sigma[i] if known else None,
        )
        for i, point in enumerate(coded)
    )
    return targets, covariance if known else None
