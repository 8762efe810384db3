"""A network of measured image points, adjusted with AICON's camera model and weights.

``x = x0 + x_s + d(x_s, y_s)`` with ``x_s = c u/w`` in mm, radial ``A1 (r² - R0²) + A2 (r⁴ - R0⁴)``,
tangential ``B1 (r² + 2 x²) + 2 B2 x y``, affinity ``C1 x + C2 y`` in x (Luhmann). All coordinates
have one weight; the datum are shift and turn over all points; everything is scaled by the sigma0
that comes out, as AICON 3D Studio does. Its own network holds rays of up to 6.2 sigma: one is left
out as a blunder from 8 sigma on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.adjustment import Block, Group, Problem, Solution, rigid_directions, solve
from omm_core.adjustment import test_observations as w_tests
from omm_core.adjustment.problem import Values
from omm_core.adjustment.statistics import predicted_covariance
from omm_core.files.aicon import AiconNetwork
from omm_core.survey.camera_model import turn_and_shift

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

PARAMETERS = ("c_mm", "x0_mm", "y0_mm", "A1", "A2", "A3", "B1", "B2", "C1", "C2")
FREE = (0, 1, 2, 3, 4, 6, 7)
SIGMA_MM = 0.0005  # of a coordinate, a priori
_REJECTION = 64.0  # t2 of a ray in units of what the rays show: 8 sigma
_MEDIAN = 1.386  # of chi-square with two degrees of freedom
_ROUNDS = 20
_FEWEST = {"point": 2, "photo": 4}  # rays that are kept, whatever they say


@dataclass(frozen=True, kw_only=True, eq=False)
class AdjustedNetwork:
    """What came out; covariances are scaled by sigma0.

    Attributes
    ----------
    images, points : tuple of int
        In the order of the solution's rows.
    solution : Solution
    sigma0_mm : float
        Of an image coordinate.
    used : (M,) bool array
        Rays that take part, in the order of the file.
    """

    images: tuple[int, ...]
    points: tuple[int, ...]
    solution: Solution
    sigma0_mm: float
    used: Flags

    def covariance_of(self, group: str) -> Array:
        """Return the covariance of lens, photos (turn, place) or points."""
        return self.solution.covariance_of(group) * self.solution.sigma0**2


def adjust_aicon(network: AiconNetwork) -> AdjustedNetwork:
    """Adjust; the file's own values are where it begins."""
    images = tuple(np.unique(network.image).tolist())
    points = tuple(np.unique(network.point).tolist())
    photo = np.searchsorted(images, network.image)
    point = np.searchsorted(points, network.point)
    lens = network.lens[None]
    held = np.ones_like(lens, dtype=bool)
    held[0, list(FREE)] = False
    places = np.array([network.points_mm[n] for n in points])
    row = {n: i for i, n in enumerate(points)}
    bars = [b for b in network.bars if b[0] in row and b[1] in row]
    rays = Block(
        name="rays", observed=network.measured_mm,
        covariance=np.broadcast_to(np.eye(2) * SIGMA_MM**2, (len(photo), 2, 2)),
        index={"lens": np.zeros_like(photo), "photos": photo, "points": point},
        evaluate=lambda v: _seen(v, photo, point, network.r0_mm),
    )  # fmt: skip
    first, second = (np.array([row[b[i]] for b in bars], dtype=np.intp) for i in (0, 1))
    lengths = Block(
        name="bars", observed=np.array([[b[2]] for b in bars]).reshape(-1, 1),
        covariance=np.array([[[b[3] ** 2]] for b in bars]).reshape(-1, 1, 1),
        index={"points": first, "points:2": second},
        evaluate=lambda v: _lengths(v["points"], first, second),
    )  # fmt: skip
    groups = (
        Group(name="lens", values=lens, held=held, names=PARAMETERS),
        Group(name="photos", values=_poses(network, images), update=turn_and_shift),
        Group(name="points", values=places),
    )
    solution, used = _without_blunders(groups, rays, lengths)
    return AdjustedNetwork(
        images=images, points=points, solution=solution, sigma0_mm=solution.sigma0 * SIGMA_MM,
        used=used,
    )  # fmt: skip


def _without_blunders(
    groups: tuple[Group, ...], rays: Block, lengths: Block
) -> tuple[Solution, Flags]:
    """Adjust, leave out the worst ray of each photograph and point, and so on until all fit."""
    numbers = {"photo": rays.index["photos"], "point": rays.index["points"]}
    start = rays.observed - rays.evaluate({g.name: g.values for g in groups})[0]
    away = np.einsum("md,md->m", start, start)
    used = np.ones(len(away), dtype=bool)
    # What lies far beside where the file's own values see it must bend nothing.
    far = np.flatnonzero(away > _REJECTION * float(np.median(away)) / _MEDIAN)
    _leave_out(used, far[np.argsort(-away[far])], numbers)
    for turn in range(_ROUNDS):
        problem = Problem(
            groups=groups, blocks=(replace(rays, used=used.copy()), lengths),
            datum={"points": rigid_directions(groups[2].values)},
        )  # fmt: skip
        solution = solve(problem)
        t2 = _tests(problem, solution, used)
        bad = np.flatnonzero(used & (t2 > _REJECTION))
        back = ~used & (t2 < _REJECTION) & (turn < _ROUNDS // 2)
        if not back.any() and not _leave_out(used, bad[np.argsort(-t2[bad])], numbers, once=True):
            break
        used |= back
    return solution, problem.blocks[0].used if problem.blocks[0].used is not None else used


def _tests(problem: Problem, solution: Solution, used: Flags) -> Array:
    """Return how badly each ray fits the others, in units of what most rays show."""
    rays = problem.blocks[0]
    t2 = w_tests(problem, solution)["rays"].t2
    known = predicted_covariance(rays, solution.derivatives["rays"], solution)
    off = solution.residuals["rays"]
    both = np.linalg.inv(known + np.asarray(rays.covariance))
    t2 = np.where(used, t2, np.einsum("mi,mij,mj->m", off, both, off))
    return np.asarray(t2 * _MEDIAN / max(float(np.median(t2[used])), 1e-12))


def _leave_out(
    used: Flags,
    rays: NDArray[np.intp],
    numbers: dict[str, NDArray[np.integer[Any]]],
    once: bool = False,
) -> bool:
    """Leave out rays in their order, as far as they can be spared; tell whether there was one."""
    taken: set[tuple[str, int]] = set()
    for ray in rays:
        keys = {(kind, int(of[ray])) for kind, of in numbers.items()}
        spared = all(np.sum(used & (of == of[ray])) > _FEWEST[kind] for kind, of in numbers.items())
        if spared and not (once and keys & taken):
            taken |= keys
            used[ray] = False
    return bool(taken)


def _poses(network: AiconNetwork, images: tuple[int, ...]) -> Array:
    stations = np.array([network.stations[n] for n in images])
    turned = Rotation.from_euler("XYZ", stations[:, 3:]).inv()  # Rx Ry Rz, camera to object
    return np.hstack([turned.as_rotvec(), stations[:, :3]])


def _seen(
    values: Values, photo: NDArray[np.intp], point: NDArray[np.intp], r0: float
) -> tuple[Array, dict[str, Array]]:
    """Return image coordinates (M, 2), mm, and their derivatives by lens, photos and points."""
    rotations = Rotation.from_rotvec(values["photos"][:, :3]).as_matrix()[photo]
    offset = values["points"][point] - values["photos"][photo, 3:]
    inside = np.einsum("mij,mj->mi", rotations, offset)
    c, x0, y0, a1, a2, a3, b1, b2, c1, c2 = values["lens"][0]
    plane = inside[:, :2] / inside[:, 2:]
    x, y = (c * plane).T
    r2 = x * x + y * y
    radial = a1 * (r2 - r0**2) + a2 * (r2**2 - r0**4) + a3 * (r2**3 - r0**6)
    slope = 2.0 * (a1 + 2.0 * a2 * r2 + 3.0 * a3 * r2**2)
    seen = np.stack([
        x0 + x + x * radial + b1 * (r2 + 2 * x * x) + 2 * b2 * x * y + c1 * x + c2 * y,
        y0 + y + y * radial + b2 * (r2 + 2 * y * y) + 2 * b1 * x * y,
    ], axis=1)  # fmt: skip
    bent = np.empty((len(x), 2, 2))  # by (x, y)
    bent[:, 0, 0] = 1.0 + radial + x * x * slope + 6 * b1 * x + 2 * b2 * y + c1
    bent[:, 0, 1] = x * y * slope + 2 * b1 * y + 2 * b2 * x + c2
    bent[:, 1, 0] = x * y * slope + 2 * b2 * x + 2 * b1 * y
    bent[:, 1, 1] = 1.0 + radial + y * y * slope + 6 * b2 * y + 2 * b1 * x
    by_lens = np.zeros((len(x), 2, 10))
    by_lens[:, :, 0] = np.einsum("mij,mj->mi", bent, plane)
    by_lens[:, 0, 1] = by_lens[:, 1, 2] = 1.0
    for column, power in ((3, 1), (4, 2), (5, 3)):
        by_lens[:, :, column] = np.stack([x, y], axis=1) * (r2**power - r0 ** (2 * power))[:, None]
    by_lens[:, :, 6] = np.stack([r2 + 2 * x * x, 2 * x * y], axis=1)
    by_lens[:, :, 7] = np.stack([2 * x * y, r2 + 2 * y * y], axis=1)
    by_lens[:, 0, 8], by_lens[:, 0, 9] = x, y
    pinhole = np.zeros((len(x), 2, 3))
    pinhole[:, 0, 0] = pinhole[:, 1, 1] = c / inside[:, 2]
    pinhole[:, :, 2] = -c * plane / inside[:, 2:]
    by_inside = bent @ pinhole
    by_point = by_inside @ rotations
    by_turn = np.cross(inside[:, None, :], by_inside)
    by_photo = np.concatenate([by_turn, -by_point], axis=2)
    return seen, {"lens": by_lens, "photos": by_photo, "points": by_point}


def _lengths(
    points: Array, first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[Array, dict[str, Array]]:
    between = points[first] - points[second]
    length = np.linalg.norm(between, axis=1, keepdims=True)
    direction = (between / length)[:, None, :]
    return length, {"points": direction, "points:2": -direction}
