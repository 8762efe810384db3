"""Which surface triangles stand for: a plane, cylinder, cone or sphere, where the corners fit.

Corners of a tessellation lie on the surface; only the triangles between them do not. So a
surface that all corners fit to the rounding of the file is taken as what it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from omm_core.overstock.face import Face
from omm_core.overstock.triangles import triangle_areas, triangle_normals

Array = NDArray[np.float64]
FEWEST_CORNERS = 8
RELATIVE = 1e-5
FLAT = 1e-9
ENOUGH_TURN = 0.01
LEAN = 0.9


@dataclass(frozen=True, kw_only=True, eq=False)
class _Corners:
    triangles: Array
    normals: Array
    areas: Array
    points: Array
    tolerance_mm: float


def recognised(triangles: Array) -> Face | None:
    """Return the face that triangles (M, 3, 3) stand for; None where it is free-form."""
    points = np.unique(triangles.reshape(-1, 3).round(9), axis=0)
    given = _Corners(
        triangles=triangles,
        normals=triangle_normals(triangles),
        areas=triangle_areas(triangles),
        points=points,
        tolerance_mm=1e-4 + RELATIVE * float(np.abs(points).max()),
    )
    plane = _plane(given)
    if plane is not None or len(points) < FEWEST_CORNERS:
        return plane
    found = [face for face in (_cylinder(given), _sphere(given), _cone(given)) if face is not None]
    # Corners of two rings lie on many surfaces; the triangles tell which is meant.
    best = max(found, key=lambda face: _lean(face, given), default=None)
    return best if best is not None and _lean(best, given) > LEAN else None


def _lean(face: Face, given: _Corners) -> float:
    """Return the cosine between triangles and surface where they agree least."""
    _, ideal = face.distance(given.triangles.mean(axis=1))
    large = given.areas > FLAT * given.areas.sum()
    return float((ideal * given.normals).sum(axis=1)[large].min())


def _plane(given: _Corners) -> Face | None:
    axis = (given.normals * given.areas[:, None]).sum(axis=0)
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return None
    axis = axis / length
    middle = given.points.mean(axis=0)
    if np.abs((given.points - middle) @ axis).max() > given.tolerance_mm:
        return None
    large = given.areas > FLAT * given.areas.sum()
    if (given.normals[large] @ axis).min() < 0.5:
        return None
    return Face(kind="plane", triangles=given.triangles, origin=middle, axis=axis)


def _sphere(given: _Corners) -> Face | None:
    middle = given.points.mean(axis=0)
    p = given.points - middle
    rows = np.hstack([2.0 * p, np.ones((len(p), 1))])
    answer, _, rank, _ = np.linalg.lstsq(rows, (p**2).sum(axis=1), rcond=1e-9)
    if rank < 4:
        return None
    radius = float(np.sqrt(max(answer[3] + answer[:3] @ answer[:3], 0.0)))
    arms = p - answer[:3]
    if np.abs(np.linalg.norm(arms, axis=1) - radius).max() > given.tolerance_mm:
        return None
    origin = middle + answer[:3]
    sign = _sign(given, given.triangles.mean(axis=1) - origin)
    return Face(
        kind="sphere",
        triangles=given.triangles,
        origin=origin,
        axis=np.array([0.0, 0.0, 1.0]),
        radius_mm=radius,
        sign=sign,
    )


def _cylinder(given: _Corners) -> Face | None:
    spread = (given.normals * given.areas[:, None]).T @ given.normals / given.areas.sum()
    values, axes = np.linalg.eigh(spread)
    if values[0] > 1e-4 or values[1] < ENOUGH_TURN**2:
        return None
    origin, start = given.points.mean(axis=0), axes[:, 0]
    across = axes[:, 1:]
    flat = (given.points - origin) @ across
    rows = np.hstack([2.0 * flat, np.ones((len(flat), 1))])
    answer = np.linalg.lstsq(rows, (flat**2).sum(axis=1), rcond=1e-9)[0]
    radius = float(np.sqrt(max(answer[2] + answer[:2] @ answer[:2], 0.0)))

    def parts(x: Array) -> tuple[Array, Array]:
        axis = start + across @ x[2:4]
        return origin + across @ x[:2], axis / np.linalg.norm(axis)

    def misfit(x: Array) -> Array:
        place, axis = parts(x)
        arms = given.points - place
        return np.asarray(np.linalg.norm(np.cross(arms, axis), axis=1) - x[4])

    found = least_squares(misfit, np.array([*answer[:2], 0.0, 0.0, radius]), x_scale="jac")
    if np.abs(found.fun).max() > given.tolerance_mm:
        return None
    place, axis = parts(found.x)
    arms = given.triangles.mean(axis=1) - place
    sign = _sign(given, arms - np.outer(arms @ axis, axis))
    return Face(
        kind="cylinder",
        triangles=given.triangles,
        origin=place,
        axis=axis,
        radius_mm=float(found.x[4]),
        sign=sign,
    )


def _cone(given: _Corners) -> Face | None:
    weight = given.areas / given.areas.sum()
    mean = weight @ given.normals
    apart = given.normals - mean
    values, axes = np.linalg.eigh((apart * weight[:, None]).T @ apart)
    if values[0] > 1e-4 or values[1] < ENOUGH_TURN**2:
        return None
    through = (given.normals * given.triangles[:, 0]).sum(axis=1)
    apex, _, rank, _ = np.linalg.lstsq(given.normals, through, rcond=1e-6)
    if rank < 3:
        return None
    start, across = axes[:, 0], axes[:, 1:]
    if (given.points.mean(axis=0) - apex) @ start < 0.0:
        start = -start

    def misfit(x: Array) -> Array:
        axis = start + across @ x[3:5]
        axis = axis / np.linalg.norm(axis)
        arms = given.points - x[:3]
        height = arms @ axis
        radius = np.linalg.norm(arms - np.outer(height, axis), axis=1)
        return np.asarray(radius * np.cos(x[5]) - height * np.sin(x[5]))

    angle = float(np.arcsin(np.clip(abs(mean @ start), 0.0, 1.0)))
    found = least_squares(misfit, np.array([*apex, 0.0, 0.0, angle]), x_scale="jac")
    if np.abs(found.fun).max() > given.tolerance_mm or not 1e-4 < found.x[5] < 1.57:
        return None
    axis = start + across @ found.x[3:5]
    axis = axis / np.linalg.norm(axis)
    arms = given.triangles.mean(axis=1) - found.x[:3]
    sign = _sign(given, arms - np.outer(arms @ axis, axis))
    return Face(
        kind="cone",
        triangles=given.triangles,
        origin=found.x[:3],
        axis=axis,
        half_angle_rad=float(found.x[5]),
        sign=sign,
    )


def _sign(given: _Corners, outward: Array) -> float:
    turned = ((given.normals * outward).sum(axis=1) * given.areas).sum()
    return 1.0 if turned > 0.0 else -1.0
