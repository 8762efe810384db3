"""What makes a coordinate of the part uncertain in the machine: u_ip, u_it, u_out, the machine.

Points are given by their places ``R p`` from the part's origin, in the machine's axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.anova import OneFactor
from omm_core.budget.budget_file import Expansion, NamedPoint
from omm_core.budget.contributor import Contributor
from omm_core.budget.evaluation import Contribution, standard
from omm_core.errors import InputError
from omm_core.files.part import Part
from omm_core.files.points import SurveyPoints
from omm_core.geometry import RigidTransform, rotation_from_euler_xyz_rad

Array = NDArray[np.float64]


def box_points(part: Part) -> tuple[NamedPoint, ...]:
    """Return the corners of the part's box, once each where it is flat."""
    low, high = part.box()
    found = []
    for corner in part.box_corners():
        words = [
            f"{axis}={corner[i]:g}" for i, axis in enumerate("xyz") if low[i] != high[i]
        ]  # a flat box has fewer corners
        found.append(NamedPoint(name=f"corner {' '.join(words) or 'all'}", xyz_mm=corner))
    return tuple({point.name: point for point in found}.values())


def pose_jacobian(theta: Sequence[float], xyz_mm: Array) -> Array:
    """Return d(R p + d) / d(α, β, γ, x, y, z) at points (P, 3) of the part, (P, 3, 6)."""
    points = np.asarray(xyz_mm, dtype=float)
    jacobian = np.zeros((len(points), 3, 6))
    alpha, beta, gamma = theta[:3]
    turned_yz = rotation_from_euler_xyz_rad(0.0, beta, gamma)
    turned_z = rotation_from_euler_xyz_rad(0.0, 0.0, gamma)
    rotated = points @ rotation_from_euler_xyz_rad(alpha, beta, gamma).T
    # R = Rz Ry Rx: each angle turns about an axis that the later ones have turned.
    for column, axis in enumerate((turned_yz[:, 0], turned_z[:, 1], np.array([0.0, 0.0, 1.0]))):
        jacobian[:, :, column] = np.cross(axis, rotated)
    jacobian[:, :, 3:] = np.eye(3)
    return jacobian


def pose_covariances(theta: Sequence[float], covariance: Array, xyz_mm: Array) -> Array:
    """Return the covariance of points' machine coordinates, (P, 3, 3) mm², from that of θ.

    Parameters
    ----------
    theta : α, β, γ (rad), x, y, z (mm) first
    covariance : (6, 6) or (7, 7) array
        In the order of θ; γ_s moves no point of the part.
    xyz_mm : (P, 3) array
        Part frame.
    """
    jacobian = pose_jacobian(theta, xyz_mm)
    own = np.asarray(covariance, dtype=float)[:6, :6]
    return np.asarray(jacobian @ own @ np.swapaxes(jacobian, 1, 2))


def from_covariances(name: str, group: str, covariances: Array, freedom: float) -> Contribution:
    """Return a normal contribution of the axes' variances, (P, 3, 3)."""
    variances = np.clip(np.einsum("pii->pi", covariances), 0.0, None)
    return Contribution(
        name=name,
        group=group,
        millimetres=np.sqrt(variances),
        shape=standard("normal", freedom),
    )


def from_studies(studies: Sequence[Sequence[OneFactor]]) -> Contribution:
    """Return u_ip as a campaign saw it: of one measurement after a new clamping, at each point.

    With one clamping, it is the repeats' alone.
    """
    seen = np.array([[_seen(one) for one in axes] for axes in studies])
    return Contribution(
        name="u_ip",
        group="u_ip",
        millimetres=seen[..., 0],
        shape=standard("normal"),
        freedom=seen[..., 1],
    )


def _seen(study: OneFactor) -> tuple[float, float]:
    if math.isnan(study.reproducibility):
        return study.repeatability, float(study.within_freedom)
    return study.reproducibility, study.degrees_of_freedom


def constant(name: str, group: str, sigma_mm: Array, places: Array, kind: str) -> Contribution:
    """Return a contribution that is the same at each point."""
    return Contribution(
        name=name,
        group=group,
        millimetres=np.broadcast_to(sigma_mm, places.shape).copy(),
        shape=standard(kind),
    )


def expansion(given: Expansion, places_mm: Array) -> list[Contribution]:
    """Return u_it: the part is warmer or colder than when it was surveyed, by what nobody knows.

    A coordinate c from the part's origin errs by c α ΔT (paper, section 4). With a mean ΔT that is
    not corrected for, what α is unsure of counts, too; with a gradient g (K per m), length and
    bending err by α g r² / 2 at most, which counts on each axis.
    """
    if given.sigma_mm is not None:
        return [constant("u_it", "u_it", given.sigma_mm, places_mm, "normal")]
    found = []
    if given.temperature is not None:
        scale = given.per_K * given.temperature.standard_uncertainty
        found.append(("u_it", scale * places_mm, given.temperature))
    if given.per_K_spread is not None:
        # GUM 5.1.2, note: the product of two deviations counts where the means are near 0.
        kelvin = np.hypot(
            given.mean_K,
            given.temperature.standard_uncertainty if given.temperature else 0.0,
        )
        scale = kelvin * given.per_K_spread.standard_uncertainty
        found.append(("u_it expansion", scale * places_mm, given.per_K_spread))
    if given.gradient is not None:
        square = np.sum(places_mm**2, axis=1, keepdims=True) / 2e3
        each = np.broadcast_to(square, places_mm.shape)
        scale = given.per_K * given.gradient.standard_uncertainty
        found.append(("u_it gradient", scale * each, given.gradient))
    return [
        Contribution(
            name=name,
            group="u_it",
            millimetres=millimetres,
            shape=standard(spread.kind, spread.degrees_of_freedom),
        )
        for name, millimetres, spread in found
    ]


def length_error(constant_mm: float, per_metre_mm: float, places_mm: Array) -> Contribution:
    """Return u_out = LME / √3 with LME = constant + per metre × distance from the origin."""
    distance_m = np.linalg.norm(places_mm, axis=1, keepdims=True) / 1e3
    limit = np.broadcast_to(constant_mm + per_metre_mm * distance_m, places_mm.shape)
    return Contribution(
        name="u_out",
        group="u_out",
        millimetres=limit / np.sqrt(3.0),
        shape=standard("uniform"),
    )


def of_contributor(given: Contributor, places_mm: Array) -> Contribution:
    """Return one of the file's own contributors, the same at each point."""
    spread = given.distribution
    each = spread.standard_uncertainty * given.sensitivity
    return Contribution(
        name=given.name,
        group="other",
        millimetres=np.broadcast_to(each, places_mm.shape).copy(),
        shape=standard(spread.kind, spread.degrees_of_freedom),
    )


def part_T_survey(part: Part, survey: SurveyPoints) -> tuple[RigidTransform | None, int]:
    """Return part_T_survey by the coded targets that both know, and how many these are.

    None where fewer than three are common: then nothing says how the survey's frame lies.
    """
    known = {point.id: point.xyz_mm for point in survey.points if point.id is not None}
    common = [target for target in part.targets if target.id in known]
    if len(common) < 3:
        return None, len(common)
    ideal = np.array([target.xyz_mm for target in common])
    seen = np.array([known[target.id] for target in common])
    u, _, vt = np.linalg.svd((ideal - ideal.mean(0)).T @ (seen - seen.mean(0)))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    shift = ideal.mean(0) - rotation @ seen.mean(0)
    return RigidTransform(rotation=rotation, translation_mm=shift), len(common)


def survey_covariances(
    points: Sequence[NamedPoint], part: Part, survey: SurveyPoints
) -> tuple[Array, tuple[str, ...]]:
    """Return the survey's covariance for each point, (P, 3, 3) in the part frame, and findings.

    A point takes the survey point of its name, else the nearest one.

    Raises
    ------
    InputError
        Where no point of the survey has a covariance.
    """
    sure = [(p, p.covariance_mm2) for p in survey.points if p.covariance_mm2 is not None]
    if not sure:
        raise InputError("Expected points with covariance_mm2 or sigma_xyz_mm for u_out, got none.")
    transform, common = part_T_survey(part, survey)
    findings = []
    if transform is None:
        transform = RigidTransform.identity()
        findings.append(
            f"u_out: part and survey have {common} coded targets in common; 3 are needed to know"
            " how the frames lie, so that they count as the same"
        )
    by_name = {point.name: covariance for point, covariance in sure}
    places = transform @ np.array([point.xyz_mm for point, _ in sure])
    found, far = [], 0.0
    for point in points:
        nearest = int(np.argmin(np.linalg.norm(places - point.xyz_mm, axis=1)))
        taken = by_name.get(point.name)
        if taken is None:
            taken = sure[nearest][1]
            far = max(far, float(np.linalg.norm(places[nearest] - point.xyz_mm)))
        found.append(transform.rotation @ taken @ transform.rotation.T)
    if far > 0.0:
        findings.append(
            "u_out: a point that the survey does not name has the uncertainty of the nearest"
            f" surveyed one, up to {far:.0f} mm away"
        )
    return np.array(found), tuple(findings)
