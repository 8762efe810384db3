"""The free network of photographs, points and scale bars, with self-calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Block, Group, Problem, Solution, rigid_directions, solve
from omm_core.adjustment import test_observations as w_tests
from omm_core.errors import MeasurementError
from omm_core.survey.camera_model import PARAMETERS, evaluate_rays, turn_and_shift, undistorted
from omm_core.survey.start import Rays, start_network

Array = NDArray[np.float64]
Index = NDArray[np.intp]

FEWEST_RAYS = 3
FEWEST_IN_PHOTO = 5
_REJECTION = 16.0  # t2 of a ray: about 4 sigma
_ROUNDS = 20
# What is freed, and from how many photographs on.
_STAGES = ((), (0, 3), (0, 1, 2, 3, 4, 6, 7), tuple(range(10)))
_PHOTOS_FOR_ALL = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class Sighting:
    """A target in a photograph: (col, row) px and its covariance."""

    photo: int
    point: int
    center_px: Array
    covariance_px2: Array


@dataclass(frozen=True, kw_only=True)
class Bar:
    """A scale bar between two points."""

    ends: tuple[int, int]
    length_mm: float
    sigma_mm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Network:
    """What came out; covariances are scaled by the estimated sigma0 of the rays.

    Attributes
    ----------
    photos, points : mapping
        Number -> row in ``values``.
    solution : Solution
    sigma0 : float
        Of the rays, against the detector's own standard deviations.
    rms_px : float
    sightings, used : the rays in the order of the block, and which took part.
    bars : the bars that were measured.
    """

    photos: dict[int, int]
    points: dict[int, int]
    solution: Solution
    sigma0: float
    rms_px: float
    sightings: tuple[Sighting, ...]
    used: NDArray[np.bool_]
    bars: tuple[Bar, ...]

    def rays_of(self, point: int) -> int:
        """Return in how many photographs a point was used."""
        return sum(
            s.point == point for s, used in zip(self.sightings, self.used, strict=True) if used
        )

    def length(self, ends: tuple[int, int]) -> tuple[float, float]:
        """Return a measured distance and its standard deviation, mm."""
        a, b = (self.points[end] for end in ends)
        between = self.solution.values["points"][a] - self.solution.values["points"][b]
        length = float(np.linalg.norm(between))
        which = np.r_[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
        covariance = self.solution.covariance_of("points")[np.ix_(which, which)]
        direction = np.r_[between, -between] / length
        return length, float(np.sqrt(direction @ covariance @ direction))


def solve_network(
    sightings: list[Sighting], bars: list[Bar], focal_length_px: float, size_px: tuple[int, int]
) -> Network:
    """Adjust from nothing but the nominal focal length.

    Raises
    ------
    MeasurementError
        Where photographs do not hang together, or no bar was measured.
    """
    middle = (np.array(size_px) - 1.0) / 2.0
    lens = np.r_[focal_length_px, np.zeros(9)]
    photos, points = start_network(_rays(sightings, lens, middle), 1.0 / focal_length_px)
    counts: dict[int, int] = {}
    for s in sightings:
        counts[s.point] = counts.get(s.point, 0) + (s.photo in photos)
    points = {p: xyz for p, xyz in points.items() if counts[p] >= FEWEST_RAYS}
    kept = tuple(s for s in sightings if s.photo in photos and s.point in points)
    there = [b for b in bars if b.ends[0] in points and b.ends[1] in points]
    if not there:
        raise MeasurementError(
            "Expected at least one scale bar whose two ends are seen in three photographs each;"
            " found none, so the coordinates have no scale. Photograph the bars more often."
        )
    spans = [np.linalg.norm(points[b.ends[0]] - points[b.ends[1]]) for b in there]
    scale = float(np.mean([b.length_mm / span for b, span in zip(there, spans, strict=True)]))
    stretch = np.r_[1.0, 1.0, 1.0, scale, scale, scale]
    fitting = _Fitting(kept, there, middle, sorted(photos), sorted(points))
    values = {
        "lens": lens[None],
        "photos": np.array([photos[i] * stretch for i in sorted(photos)]),
        "points": np.array([points[i] * scale for i in sorted(points)]),
    }
    return fitting.solved(values)


def _rays(sightings: list[Sighting], lens: Array, middle: Array) -> Rays:
    ideal = undistorted(lens, np.array([s.center_px for s in sightings]) - middle)
    rays: Rays = {}
    for sighting, ray in zip(sightings, ideal, strict=True):
        rays.setdefault(sighting.photo, {})[sighting.point] = ray
    return rays


class _Fitting:
    """The adjustment in stages; leaves out what the tests reject."""

    def __init__(
        self,
        sightings: tuple[Sighting, ...],
        bars: list[Bar],
        middle: Array,
        photos: list[int],
        points: list[int],
    ) -> None:
        self.sightings, self.bars, self.middle = sightings, bars, middle
        self.photos = {number: row for row, number in enumerate(photos)}
        self.points = {number: row for row, number in enumerate(points)}
        self.photo = np.array([self.photos[s.photo] for s in sightings])
        self.point = np.array([self.points[s.point] for s in sightings])
        self.seen = np.array([s.center_px for s in sightings])
        self.covariance = np.array([s.covariance_px2 for s in sightings])
        self.used = np.ones(len(sightings), dtype=bool)
        self.factor = 1.0

    def solved(self, values: dict[str, Array]) -> Network:
        """Free the calibration in stages, reject, and estimate sigma0 of the rays."""
        stages = _STAGES if len(self.photos) >= _PHOTOS_FOR_ALL else _STAGES[:3]
        for stage in stages:
            if stage == stages[-1]:  # what only a held lens could not explain comes back
                self.used[:] = True
            for _ in range(_ROUNDS):
                problem = self._problem(values, stage)
                solution = solve(problem)
                values = dict(solution.values)
                tests = w_tests(problem, solution)["rays"]
                redundancy = float(tests.redundancy[self.used].sum())
                weights = problem.blocks[0].weights()
                residuals = solution.residuals["rays"]
                cost = float(np.einsum("mi,mij,mj->", residuals, weights, residuals))
                ratio = cost / max(redundancy, 1.0)
                self.factor *= np.sqrt(ratio)
                if not self._reject(tests.t2 / ratio) and abs(ratio - 1.0) < 0.02:
                    break
        rms = float(np.sqrt(np.mean(residuals[self.used] ** 2)))
        return Network(
            photos=self.photos, points=self.points, solution=solution, sigma0=float(self.factor),
            rms_px=rms, sightings=self.sightings, used=self.used, bars=tuple(self.bars),
        )  # fmt: skip

    def _reject(self, t2: Array) -> bool:
        """Leave out the worst ray of each photograph and of each point; True if there was one."""
        bad = np.flatnonzero(self.used & (t2 > _REJECTION))
        taken: set[tuple[str, int]] = set()
        for ray in bad[np.argsort(-t2[bad])]:
            keys = {("photo", int(self.photo[ray])), ("point", int(self.point[ray]))}
            if keys & taken or np.sum(self.used & (self.point == self.point[ray])) <= 2:
                continue
            taken |= keys
            self.used[ray] = False
        return bool(taken)

    def _problem(self, values: dict[str, Array], stage: tuple[int, ...]) -> Problem:
        held = np.ones((1, 10), dtype=bool)
        held[0, list(stage)] = False
        rays = Block(
            name="rays", observed=self.seen, covariance=self.covariance * self.factor**2,
            index={"lens": np.zeros_like(self.photo), "photos": self.photo, "points": self.point},
            evaluate=lambda v: evaluate_rays(v, self.photo, self.point, self.middle),
            used=self.used,
        )  # fmt: skip
        first, second = (np.array([self.points[b.ends[i]] for b in self.bars]) for i in (0, 1))
        bars = Block(
            name="bars", observed=np.array([[b.length_mm] for b in self.bars]),
            covariance=np.array([[[b.sigma_mm**2]] for b in self.bars]),
            index={"points": first, "points:2": second},
            evaluate=lambda v: _lengths(v["points"], first, second),
        )  # fmt: skip
        return Problem(
            groups=(
                Group(name="lens", values=values["lens"], held=held, names=PARAMETERS),
                Group(name="photos", values=values["photos"], update=turn_and_shift),
                Group(name="points", values=values["points"]),
            ),
            blocks=(rays, bars),
            datum={"points": rigid_directions(values["points"])},
        )


def _lengths(points: Array, first: Index, second: Index) -> tuple[Array, dict[str, Array]]:
    between = points[first] - points[second]
    length = np.linalg.norm(between, axis=1, keepdims=True)
    direction = (between / length)[:, None, :]
    return length, {"points": direction, "points:2": -direction}
