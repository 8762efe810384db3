"""The circles that the targets are: normals and diameters from ellipses, and what they shift.

To first order a circle (centre X, unit normal n, radius r) is seen as the ellipse with
``S = r² (J Jᵀ - (J n)(J n)ᵀ)``, J = d(pixel)/dX (2, 3). Several views tell n and r; one diameter
for all dots of a kind is the median, or what was declared. The centre of the image of the circle
less the image of its centre is then what `imaging.circle` says, through this camera's lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.imaging.circle import BOUNDARY_POINTS, centre_weights_of_many, circle_points
from omm_core.survey.camera_model import lens_pixels
from omm_core.survey.sighting import Sighting

Array = NDArray[np.float64]

_TURNS = 12
_SETTLED = 1e-6
_FLAT = np.array([1.0, np.sqrt(2.0), 1.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Circle:
    """A target's face.

    Attributes
    ----------
    normal : (3,) array
        Towards the cameras.
    diameter_mm : float
        As measured on this target alone.
    misfit : float
        RMS by which its ellipses differ from those of a circle, of their size.
    views : int
        Ellipses that tell.
    """

    normal: Array
    diameter_mm: float
    misfit: float
    views: int


def circles_of(
    values: dict[str, Array],
    sightings: tuple[Sighting, ...],
    photo: NDArray[np.intp],
    point: NDArray[np.intp],
    used: NDArray[np.bool_],
    jacobians: Array,
    before: dict[int, Circle],
) -> dict[int, Circle]:
    """Return the circles by row of their point, where two views or more tell them.

    ``jacobians`` (M, 2, 3) are d(pixel)/d(point); ``before`` are circles that are nearly known:
    where the search begins.
    """
    there = used & np.array([s.spread_px2 is not None for s in sightings])
    found: dict[int, Circle] = {}
    every = np.flatnonzero(there)
    if not len(every):
        return found
    every = every[np.argsort(point[every], kind="stable")]
    rows, starts = np.unique(point[every], return_index=True)
    for row, rays in zip(rows, np.split(every, starts[1:]), strict=True):
        spreads = np.array([sightings[i].spread_px2 for i in rays])
        towards = values["photos"][photo[rays], 3:] - values["points"][row]
        known = before.get(int(row))
        circle = _circle(jacobians[rays], spreads, towards, known)
        if circle is not None:
            found[int(row)] = circle
    return found


def _circle(
    jacobians: Array, spreads: Array, towards: Array, known: Circle | None
) -> Circle | None:
    if len(spreads) < 2:
        return None
    weight = 1.0 / np.sqrt(np.linalg.det(spreads))
    seen = _flat(spreads) * weight[:, None]
    directions = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    best: tuple[float, Array, float] | None = None
    for start in _starts(directions) if known is None else [known.normal]:
        cost, normal, r2 = _fitted(jacobians, seen, weight, start)
        if (normal @ directions.T > 0.0).all() and (best is None or cost < best[0]):
            best = (cost, normal, r2)
    if best is None or best[2] <= 0.0:
        return None
    rms = float(np.sqrt(best[0] / seen.size))
    return Circle(
        normal=best[1], diameter_mm=2.0 * float(np.sqrt(best[2])), misfit=rms, views=len(seen)
    )


def _starts(directions: Array) -> list[Array]:
    """Return normals to start from: towards all cameras, and leant to four sides."""
    mean = directions.mean(axis=0)
    mean /= np.linalg.norm(mean)
    across, other = _across(mean)
    return [mean + 0.7 * side for side in (0 * across, across, -across, other, -other)]


def _across(normal: Array) -> tuple[Array, Array]:
    """Return two unit vectors at right angles to a unit vector and to each other."""
    x, y, z = normal
    first = np.array([0.0, -z, y]) if abs(x) < 0.6 else np.array([z, 0.0, -x])
    first = first / np.sqrt(first @ first)
    a, b, c = first
    return first, np.array([y * c - z * b, z * a - x * c, x * b - y * a])


def _fitted(
    jacobians: Array, seen: Array, weight: Array, start: Array
) -> tuple[float, Array, float]:
    """Return the cost, normal and squared radius that fit weighted ellipses best."""
    normal = start / np.linalg.norm(start)
    whole = _flat(jacobians @ np.swapaxes(jacobians, 1, 2)) * weight[:, None]
    cost, r2 = np.inf, 1.0
    for _ in range(_TURNS):
        jn = jacobians @ normal
        shape = whole - _flat(jn[:, :, None] * jn[:, None, :]) * weight[:, None]
        r2 = float(np.sum(shape * seen) / np.sum(shape * shape))
        rest = seen - r2 * shape
        before, cost = cost, float(np.sum(rest**2))
        if before - cost < _SETTLED * cost:
            break
        sides = _across(normal)
        columns = [shape.ravel()]
        for side in sides:
            js = jacobians @ side
            both = jn[:, :, None] * js[:, None, :]
            slope = -_flat(both + np.swapaxes(both, 1, 2)) * weight[:, None] * r2
            columns.append(slope.ravel())
        slopes = np.stack(columns, axis=1)
        normals = slopes.T @ slopes
        normals.flat[::4] *= 1.0 + 1e-9
        step = np.linalg.solve(normals, slopes.T @ rest.ravel())
        lean = step[1] * sides[0] + step[2] * sides[1]
        normal = normal + lean * min(1.0, 0.4 / max(float(np.linalg.norm(lean)), 1e-12))
        normal /= np.linalg.norm(normal)
    return cost, normal, r2


def _flat(matrices: Array) -> Array:
    """Return symmetric (M, 2, 2) as (M, 3), the mixed term with its double weight's root."""
    return matrices.reshape(-1, 4)[:, [0, 1, 3]] * _FLAT


def eccentricities(
    values: dict[str, Array],
    lens: Array,
    photo: NDArray[np.intp],
    point: NDArray[np.intp],
    normals: Array,
    diameters_mm: Array,
) -> Array:
    """Return by how much the ellipse's centre lies off the image of the circle's centre, (M, 2) px.

    Parameters
    ----------
    lens : (10,) or (M, 10) array
    normals, diameters_mm : (T, 3), (T,) arrays
        By row of the points; not finite where not known: nothing is corrected there.
    """
    shift = np.zeros((len(photo), 2))
    known = np.isfinite(normals).all(axis=1) & np.isfinite(diameters_mm)
    rays = np.flatnonzero(known[point])
    if not len(rays):
        return shift
    rotations = Rotation.from_rotvec(values["photos"][:, :3]).as_matrix()[photo[rays]]
    rows = point[rays]
    offset = values["points"][rows] - values["photos"][photo[rays], 3:]
    around = circle_points(offset, normals[rows], diameters_mm[rows])
    inside = np.einsum("mij,mkj->mki", rotations, around)
    own = lens if lens.ndim == 1 else lens[rays]
    of_outline = own if own.ndim == 1 else np.repeat(own, BOUNDARY_POINTS, axis=0)
    outlines = lens_pixels(of_outline, inside.reshape(-1, 3)).reshape(-1, BOUNDARY_POINTS, 2)
    centres = np.einsum("mkij,mkj->mi", centre_weights_of_many(outlines), outlines)
    shift[rays] = centres - lens_pixels(own, np.einsum("mij,mj->mi", rotations, offset))
    return shift
