"""The free network of photographs, points and scale bars, with self-calibration."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import (
    Block,
    Group,
    Problem,
    Solution,
    rigid_directions,
    similarity_directions,
    solve,
)
from omm_core.adjustment import test_observations as w_tests
from omm_core.survey.camera_model import PARAMETERS, evaluate_rays, turn_and_shift
from omm_core.survey.circles import Circle, circles_of, eccentricities
from omm_core.survey.noise import Noise, estimated
from omm_core.survey.sighting import CODED, PLAIN, Bar, Sighting

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Values = dict[str, Array]

FEWEST_RAYS = 3
FEWEST_IN_PHOTO = 4
REJECTION = 16.0  # t2 of a ray: about 4 sigma
_ROUNDS = 25
# What is freed, and from how many photographs on.
STAGES = ((), (0, 3), (0, 1, 2, 3, 4, 6, 7), tuple(range(10)))
PHOTOS_FOR_ALL = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class Network:
    """What came out of an adjustment.

    Attributes
    ----------
    photos, points : mapping
        Number -> row in ``solution.values``.
    solution : Solution
        Its covariance is that of the noise which the residuals show.
    noise : Noise
    sightings, used : the rays in the order of the block, and which took part.
    circles : mapping
        Faces of the targets, by number of the point.
    diameters_mm : mapping
        Of the dots, by kind; what was declared, or measured.
    bars : the bars that were measured.
    middle_px : (2,) array
    t2 : (M,) array
        Test of each ray, chi-square of two.
    left_out_points, left_out_photos : mapping
        Why coded targets and photographs do not take part, by number.
    words : tuple of str
        What else must be told.
    """

    photos: dict[int, int]
    points: dict[int, int]
    solution: Solution
    noise: Noise
    sightings: tuple[Sighting, ...]
    used: NDArray[np.bool_]
    bars: tuple[Bar, ...]
    middle_px: Array
    t2: Array
    circles: dict[int, Circle] = field(default_factory=dict)
    diameters_mm: dict[str, float] = field(default_factory=dict)
    left_out_points: dict[int, str] = field(default_factory=dict)
    left_out_photos: dict[int, str] = field(default_factory=dict)
    words: tuple[str, ...] = ()

    @property
    def lens(self) -> Array:
        """Return the lens (10,), see `camera_model.PARAMETERS`."""
        return self.solution.values["lens"][0]

    @property
    def rms_px(self) -> float:
        """Return the root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.solution.residuals["rays"][self.used] ** 2)))

    @property
    def sigma0(self) -> float:
        """Return how many times the detector's standard deviation the rays show."""
        return self.noise.sigma0(_detector(self.sightings), self.kinds, self.used)

    @property
    def sigma0_by(self) -> dict[str, float]:
        """Return the same by kind of target."""
        by = {}
        for kind in np.unique(self.kinds):
            rays = self.used & (self.kinds == kind)
            if rays.any():
                by[str(kind)] = self.noise.sigma0(_detector(self.sightings), self.kinds, rays)
        return by

    @property
    def kinds(self) -> NDArray[np.str_]:
        """Return the kind of each ray."""
        return np.array([s.kind for s in self.sightings])

    def xyz_mm(self, point: int) -> Array:
        """Return the place of a point."""
        return self.solution.values["points"][self.points[point]]

    def pose(self, photo: int) -> Array:
        """Return turn and place (6,) of a photograph."""
        return self.solution.values["photos"][self.photos[photo]]

    def rays_of(self, point: int) -> int:
        """Return in how many photographs a point was used."""
        return self.ray_counts().get(point, 0)

    def ray_counts(self) -> dict[int, int]:
        """Return in how many photographs each point was used."""
        counts: dict[int, int] = {}
        for s, used in zip(self.sightings, self.used, strict=True):
            counts[s.point] = counts.get(s.point, 0) + int(used)
        return counts

    def length(self, ends: tuple[int, int]) -> tuple[float, float]:
        """Return a measured distance and its standard deviation, mm."""
        a, b = (self.points[end] for end in ends)
        between = self.solution.values["points"][a] - self.solution.values["points"][b]
        length = float(np.linalg.norm(between))
        which = np.r_[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
        covariance = self.solution.covariance_of("points")[np.ix_(which, which)]
        direction = np.r_[between, -between] / length
        return length, float(np.sqrt(direction @ covariance @ direction))


@dataclass(frozen=True, kw_only=True, eq=False)
class NetworkState:
    """Where an adjustment begins: places by number, the lens, and what is known of noise, dots."""

    lens: Array
    photos: dict[int, Array]
    points: dict[int, Array]
    noise: Noise = field(default_factory=Noise)
    declared_mm: dict[str, float] = field(default_factory=dict)
    circles: dict[int, Circle] = field(default_factory=dict)
    diameters_mm: dict[str, float] = field(default_factory=dict)


def state_of(network: Network, declared_mm: dict[str, float]) -> NetworkState:
    """Return where a network stands, to go on from."""
    values = network.solution.values
    return NetworkState(
        lens=values["lens"][0].copy(),
        photos={n: values["photos"][row].copy() for n, row in network.photos.items()},
        points={n: values["points"][row].copy() for n, row in network.points.items()},
        noise=network.noise, declared_mm=declared_mm, circles=network.circles,
        diameters_mm=network.diameters_mm,
    )  # fmt: skip


def adjusted(
    state: NetworkState,
    sightings: list[Sighting],
    bars: list[Bar],
    middle_px: Array,
    stages: tuple[tuple[int, ...], ...],
    rejection: float = 36.0,
) -> Network:
    """Adjust what the state knows the places of; leave out what the tests reject.

    Parameters
    ----------
    stages : tuple
        Columns of the lens that are freed, stage after stage.
    rejection : float
        Test value of a ray from which on it is left out: its sigmas, squared.
    """
    kept = _tied(state, sightings)
    seen = {s.point for s in kept}
    there = [b for b in bars if set(b.ends) <= seen]
    return _Fitting(state, kept, there, middle_px, rejection).solved(stages)


def _tied(state: NetworkState, sightings: list[Sighting]) -> tuple[Sighting, ...]:
    """Return the rays whose photograph and point have enough others to be placed by."""
    kept = [s for s in sightings if s.photo in state.photos and s.point in state.points]
    while True:
        of_photo = Counter(s.photo for s in kept)
        of_point = Counter(s.point for s in kept)
        fewer = [s for s in kept if of_photo[s.photo] >= FEWEST_IN_PHOTO and of_point[s.point] >= 2]
        if len(fewer) == len(kept):
            return tuple(kept)
        kept = fewer


def stages_for(photos: int) -> tuple[tuple[int, ...], ...]:
    """Return which stages so many photographs can bear."""
    return STAGES if photos >= PHOTOS_FOR_ALL else STAGES[:3] if photos >= 4 else STAGES[:1]


def _detector(sightings: tuple[Sighting, ...]) -> Array:
    return np.array([s.covariance_px2 for s in sightings]).reshape(-1, 2, 2)


class _Fitting:
    """The adjustment in stages."""

    def __init__(
        self,
        state: NetworkState,
        sightings: tuple[Sighting, ...],
        bars: list[Bar],
        middle: Array,
        rejection: float,
    ) -> None:
        self.rejection = rejection
        self.state, self.sightings, self.bars, self.middle = state, sightings, bars, middle
        self.photos = {n: row for row, n in enumerate(sorted({s.photo for s in sightings}))}
        self.points = {n: row for row, n in enumerate(sorted({s.point for s in sightings}))}
        self.photo = np.array([self.photos[s.photo] for s in sightings])
        self.point = np.array([self.points[s.point] for s in sightings])
        self.kinds = np.array([s.kind for s in sightings])
        self.seen = np.array([s.center_px for s in sightings])
        self.detector = _detector(sightings)
        self.shift = np.zeros_like(self.seen)
        self.used = np.ones(len(sightings), dtype=bool)
        self.noise = state.noise
        self.circles, self.diameters = dict(state.circles), dict(state.diameters_mm)

    def solved(self, stages: tuple[tuple[int, ...], ...]) -> Network:
        """Free the calibration in stages, reject, and estimate the noise of the rays."""
        values: Values = {
            "lens": self.state.lens[None].copy(),
            "photos": np.array([self.state.photos[n] for n in self.photos]),
            "points": np.array([self.state.points[n] for n in self.points]),
        }
        for stage in stages:
            last = stage == stages[-1]
            if last:  # what only a held lens could not explain comes back
                self.used[:] = True
            for turn in range(_ROUNDS):
                if self.circles:
                    self._correct(values)
                problem = self._problem(values, stage)
                solution = solve(problem, undetermined=False)
                values = dict(solution.values)
                tests = w_tests(problem, solution)["rays"]
                out = self._reject(tests.t2)
                change = self._learn(solution.residuals["rays"], tests.redundancy)
                if not out and change < 0.02 and (not last or turn >= 1):
                    break
                if last:
                    self._look(values)
        return Network(
            photos=self.photos, points=self.points, solution=solution, noise=self.noise,
            sightings=self.sightings, used=self.used, bars=tuple(self.bars),
            middle_px=self.middle, t2=tests.t2, diameters_mm=self.diameters,
            circles={n: self.circles[n] for n in self.points if n in self.circles},
        )  # fmt: skip

    def _learn(self, residuals: Array, redundancy: Array) -> float:
        """Estimate the noise anew; return by how much its standard deviation changed."""
        before = self.noise
        self.noise = estimated(
            residuals[self.used], redundancy[self.used], self.detector[self.used],
            self.kinds[self.used], before,
        )  # fmt: skip
        old, new = (
            np.sqrt(np.einsum("mii->mi", n.covariance(self.detector, self.kinds)))
            for n in (before, self.noise)
        )
        return float(np.abs(new / old - 1.0).max())

    def _look(self, values: Values) -> None:
        """Take normals and diameters from the ellipses."""
        numbers = list(self.points)
        before = {row: self.circles[n] for n, row in self.points.items() if n in self.circles}
        circles = circles_of(
            values, self.sightings, self.photo, self.point, self.used, self.middle, before
        )
        self.circles = {numbers[row]: circle for row, circle in circles.items()}
        for kind in (CODED, PLAIN):
            of_kind = [c for n, c in self.circles.items() if (n < 0) == (kind == PLAIN)]
            if kind in self.state.declared_mm:
                self.diameters[kind] = self.state.declared_mm[kind]
            elif of_kind:
                self.diameters[kind] = float(np.median([c.diameter_mm for c in of_kind]))

    def _correct(self, values: Values) -> None:
        """Compute by how much perspective shifts the centres."""
        normals = np.full((len(self.points), 3), np.nan)
        diameters = np.full(len(self.points), np.nan)
        for number, row in self.points.items():
            if number in self.circles:
                normals[row] = self.circles[number].normal
                diameters[row] = self.diameters.get(PLAIN if number < 0 else CODED, np.nan)
        self.shift = eccentricities(values, self.photo, self.point, normals, diameters)

    def _reject(self, t2: Array) -> bool:
        """Reject the worst ray of each photograph and point; return whether there was one."""
        scale = max(float(np.median(t2[self.used])) / 1.386, 1.0)  # median of chi-square of two
        bad = np.flatnonzero(self.used & (t2 > self.rejection * scale))
        taken: set[tuple[str, int]] = set()
        for ray in bad[np.argsort(-t2[bad])]:
            keys = {("photo", int(self.photo[ray])), ("point", int(self.point[ray]))}
            if keys & taken or not self._can_spare(ray):
                continue
            taken |= keys
            self.used[ray] = False
        return bool(taken)

    def _can_spare(self, ray: np.intp) -> bool:
        """Return whether enough is left without a ray to place its photograph and its point."""
        of_point = int(np.sum(self.used & (self.point == self.point[ray])))
        of_photo = int(np.sum(self.used & (self.photo == self.photo[ray])))
        return of_point > FEWEST_RAYS and of_photo > FEWEST_IN_PHOTO

    def _problem(self, values: Values, stage: tuple[int, ...]) -> Problem:
        held = np.ones((1, len(PARAMETERS)), dtype=bool)
        held[0, list(stage)] = False
        rays = Block(
            name="rays", observed=self.seen - self.shift,
            covariance=self.noise.covariance(self.detector, self.kinds),
            index={"lens": np.zeros_like(self.photo), "photos": self.photo, "points": self.point},
            evaluate=lambda v: evaluate_rays(v, self.photo, self.point, self.middle),
            used=self.used,
        )  # fmt: skip
        blocks, datum = [rays], similarity_directions(values["points"])
        if self.bars:
            blocks.append(_bar_block(self.bars, self.points))
            datum = rigid_directions(values["points"])
        return Problem(
            groups=(
                Group(name="lens", values=values["lens"], held=held, names=PARAMETERS),
                Group(name="photos", values=values["photos"], update=turn_and_shift),
                Group(name="points", values=values["points"]),
            ),
            blocks=tuple(blocks),
            datum={"points": datum},
        )


def _bar_block(bars: list[Bar], points: dict[int, int]) -> Block:
    first, second = (np.array([points[b.ends[i]] for b in bars]) for i in (0, 1))
    return Block(
        name="bars", observed=np.array([[b.length_mm] for b in bars]),
        covariance=np.array([[[b.sigma_mm**2]] for b in bars]),
        index={"points": first, "points:2": second},
        evaluate=lambda v: _lengths(v["points"], first, second),
    )  # fmt: skip


def _lengths(points: Array, first: Index, second: Index) -> tuple[Array, dict[str, Array]]:
    between = points[first] - points[second]
    length = np.linalg.norm(between, axis=1, keepdims=True)
    direction = (between / length)[:, None, :]
    return length, {"points": direction, "points:2": -direction}
