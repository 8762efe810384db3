"""The adjustment of a network in stages: blunders found, noise, normals and diameters estimated.

Many blunders at once hide behind each other in least squares. Where the first solution shows any,
weights that fall with the residual (Geman and McClure 1987), from far to near (Blake and Zisserman
1987), find them; these weights then go, and the ordinary tests decide, which also bring back what
was suspected wrongly.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

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
from omm_core.adjustment.statistics import predicted_covariance
from omm_core.survey.bar_block import bar_block
from omm_core.survey.camera_model import PARAMETERS, evaluate_rays, lens_rows, turn_and_shift
from omm_core.survey.circles import circles_of, eccentricities
from omm_core.survey.hopeless import HopelessError
from omm_core.survey.network import (
    FEWEST_IN_PHOTO,
    FEWEST_RAYS,
    STAGES,
    Network,
    NetworkState,
    detector_covariances,
    noise_kinds,
    stages_for,
)
from omm_core.survey.noise import estimated
from omm_core.survey.sighting import CODED, PLAIN, Bar, Sighting

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Values = dict[str, Array]

_ROUNDS = 25
_MEDIAN = 1.386  # of chi-square with two degrees of freedom
_ROBUST_ROUNDS, _ROBUST_STEPS = 25, 3
_KNEE, _FALL = 3.0, 0.5  # sigmas where a weight begins to fall, in the end; how it gets there
_FAR_PX = 60.0  # from where a ray should be, at the start
_MOST_DOUBT, _FAR = 1e4, 10.0  # times the variance; times the knee: does not take part
_ANCHOR = 0.3  # of the network's size: sigma of a point's place while blunders are searched for
_ALL_BESIDE_OTHERS = 8  # photographs that tell all of a lens, beside other cameras
_BACK = 1.0  # of the rejection: what is better than that comes back, once
ZOOM_SIGMA = 0.03  # of the focal length, a priori, where each photograph may have its own


def adjusted(
    state: NetworkState,
    sightings: list[Sighting],
    bars: list[Bar],
    middle_px: Array,
    stages: tuple[tuple[int, ...], ...],
    rejection: float = 36.0,
    zooms: bool = False,
) -> Network:
    """Adjust what the state knows the places of; leave out what the tests reject.

    Parameters
    ----------
    stages : tuple
        Columns of the lens that are freed, stage after stage.
    rejection : float
        Test value of a ray from which on it is left out: its sigmas, squared.
    zooms : bool
        Whether each photograph may have a focal length of its own (group ``zooms``: its logarithm
        over the common one).

    Raises
    ------
    LinAlgError
        Where nothing holds the network together.
    """
    photos: dict[int, str] = {}
    points: dict[int, str] = {}
    while True:
        kept = _tied(state, sightings)
        if not kept:
            raise np.linalg.LinAlgError("No two photographs are left that tie each other.")
        seen = {s.point for s in kept}
        there = [b for b in bars if set(b.ends) <= seen]
        fitting = Fitting(state, kept, there, middle_px, rejection, zooms=zooms)
        try:
            network = fitting.solved(stages)
        except HopelessError as hopeless:
            points |= hopeless.points
            photos |= hopeless.photos
            state = hopeless.rest_of(state)
            continue
        return replace(network, left_out_photos=photos, left_out_points=points)


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


class Fitting:
    """The adjustment in stages."""

    def __init__(
        self,
        state: NetworkState,
        sightings: tuple[Sighting, ...],
        bars: list[Bar],
        middle: Array,
        rejection: float,
        *,
        zooms: bool = False,
    ) -> None:
        self.rejection, self.zooms = rejection, zooms
        self.state, self.sightings, self.bars, self.middle = state, sightings, bars, middle
        self.photos = {n: row for row, n in enumerate(sorted({s.photo for s in sightings}))}
        self.points = {n: row for row, n in enumerate(sorted({s.point for s in sightings}))}
        self.photo = np.array([self.photos[s.photo] for s in sightings])
        self.point = np.array([self.points[s.point] for s in sightings])
        self.camera = state.cameras.rows(s.photo for s in sightings)
        self.kinds = noise_kinds(sightings, state.cameras)
        self.seen = np.array([s.center_px for s in sightings])
        self.detector = detector_covariances(sightings)
        self.shift = np.zeros_like(self.seen)
        self.used = np.ones(len(sightings), dtype=bool)
        self.returned = np.zeros(len(sightings), dtype=bool)
        self.doubt = np.ones(len(sightings))  # times the variance
        self.noise = state.noise
        self.circles, self.diameters = dict(state.circles), dict(state.diameters_mm)

    def solved(self, stages: tuple[tuple[int, ...], ...]) -> Network:
        """Free the calibration in stages, reject, and estimate the noise of the rays."""
        values: Values = {
            "lens": self.state.lenses.copy(),
            "photos": np.array([self.state.photos[n] for n in self.photos]),
            "points": np.array([self.state.points[n] for n in self.points]),
            "zooms": np.zeros((len(self.photos), 1)),
        }
        self._leave_out_far(values)
        for stage in stages:
            last = stage == stages[-1]
            values = self._search(values, stage, last=last)
            for turn in range(_ROUNDS):
                if self.circles:
                    self._correct(values)
                problem = self._problem(values, stage)
                solution = solve(problem, undetermined=False)
                values = dict(solution.values)
                tests = w_tests(problem, solution)["rays"]
                out = self._reject(tests.t2)
                out |= last and self._bring_back(problem.blocks[0], solution)
                change = self._learn(solution.residuals["rays"], tests.redundancy)
                if not out and change < 0.02 and (not last or turn >= 1):
                    break
                if last:
                    self._look(values)
        return Network(
            photos=self.photos, points=self.points, solution=solution, noise=self.noise,
            cameras=self.state.cameras, sightings=self.sightings, used=self.used,
            bars=tuple(self.bars), middle_px=self.middle, t2=tests.t2, diameters_mm=self.diameters,
            circles={n: self.circles[n] for n in self.points if n in self.circles},
        )  # fmt: skip

    def problem(self, values: Values, stage: tuple[int, ...]) -> Problem:
        """Return what is adjusted at given values."""
        return self._problem(values, stage)

    def _search(self, values: Values, stage: tuple[int, ...], *, last: bool) -> Values:
        """Find blunders by robust weights, where there are any; return where that ends."""
        anchor = values["points"]  # so that blunders carry nothing away
        problem = self._problem(values, stage, anchor)
        solution = solve(problem, undetermined=False)
        t2 = w_tests(problem, solution)["rays"].t2
        self.used[:] = True  # what only a held lens could not explain comes back
        if t2.max() <= self.rejection * max(float(np.median(t2)) / _MEDIAN, 1.0):
            return dict(solution.values)
        rest = self.seen - self.shift - self._evaluated(values)[0]
        if np.median(np.abs(solution.residuals["rays"])) < np.median(np.abs(rest)):
            values, rest = dict(solution.values), solution.residuals["rays"]
        # Else blunders bent what was known better before.
        knee = np.inf
        inverse = np.linalg.inv(self.noise.covariance(self.detector, self.kinds))
        for _ in range(_ROBUST_ROUNDS):
            t2 = np.einsum("mi,mij,mj->m", rest, inverse, rest)
            scale = float(np.sqrt(np.median(t2) / _MEDIAN))
            # From the largest residual down: at once, what one blunder bent would be doubted.
            before, knee = knee, max(_KNEE * scale, _FALL * min(knee, float(np.sqrt(t2.max()))))
            if knee > 0.95 * before:
                break
            self.doubt = np.minimum((1.0 + t2 / knee**2) ** 2, _MOST_DOUBT)
            self.used[:] = True
            self._leave_out(np.flatnonzero(t2 > (_FAR * knee) ** 2), t2)
            problem = self._problem(values, stage, anchor)
            solution = solve(problem, iterations=_ROBUST_STEPS, undetermined=False)
            values, rest = dict(solution.values), solution.residuals["rays"]
        self.doubt[:] = 1.0
        self.used[:] = True
        limit = self.rejection * scale**2
        hopeless = HopelessError(self, values, t2, limit)
        if hopeless and last:
            raise hopeless
        self._leave_out(np.flatnonzero(t2 > limit), t2)
        return values

    def _leave_out_far(self, values: Values) -> None:
        """Leave out what no pose or lens explains, so that it bends nothing to begin with."""
        away = np.linalg.norm(self.seen - self._evaluated(values)[0], axis=1)
        self._leave_out(np.flatnonzero(away > max(_FAR_PX, _FAR * np.median(away))), away)

    def _leave_out(self, rays: Index, t2: Array) -> None:
        """Leave out rays, the worst first, as far as their photographs and points can spare."""
        for ray in rays[np.argsort(-t2[rays])]:
            if self._can_spare(ray):
                self.used[ray] = False

    def _bring_back(self, rays: Block, solution: Solution) -> bool:
        """Take rays again that fit what the others say of them; True if there was one.

        What few others say of a ray is uncertain: it counts with the ray's own noise.
        """
        known = predicted_covariance(rays, solution.derivatives[rays.name], solution)
        both = np.linalg.inv(known + self.noise.covariance(self.detector, self.kinds))
        off = solution.residuals[rays.name]
        fits = np.einsum("mi,mij,mj->m", off, both, off) < _BACK * self.rejection
        back = ~self.used & ~self.returned & fits
        self.used |= back
        self.returned |= back
        return bool(back.any())

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
        _, slopes = evaluate_rays(values, self.photo, self.point, self.middle, self.camera)
        circles = circles_of(
            values, self.sightings, self.photo, self.point, self.used, slopes["points"], before
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
        lenses = lens_rows(values["lens"], self.camera)
        self.shift = eccentricities(values, lenses, self.photo, self.point, normals, diameters)

    def _reject(self, t2: Array) -> bool:
        """Reject the worst ray of each photograph and point; return whether there was one."""
        scale = max(float(np.median(t2[self.used])) / _MEDIAN, 1.0)
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

    def _problem(
        self, values: Values, stage: tuple[int, ...], anchor: Array | None = None
    ) -> Problem:
        held = np.ones_like(values["lens"], dtype=bool)
        for camera in range(len(held)):
            held[camera, [c for c in stage if c in self._bears(camera)]] = False
        rays = Block(
            name="rays", observed=self.seen - self.shift,
            covariance=self.noise.covariance(self.detector, self.kinds) * self.doubt[:, None, None],
            index={
                "lens": self.camera, "photos": self.photo, "points": self.point,
                "zooms": self.photo,
            },
            evaluate=self._evaluated,
            used=self.used,
        )  # fmt: skip
        blocks, datum = [rays], similarity_directions(values["points"])
        if self.bars:
            blocks.append(bar_block(self.bars, self.points))
            datum = rigid_directions(values["points"])
        loose = None
        if anchor is not None:
            loose = np.full_like(anchor, _ANCHOR * float(np.ptp(anchor, axis=0).max()))
        return Problem(
            groups=(
                Group(name="lens", values=values["lens"], held=held, names=PARAMETERS),
                Group(name="photos", values=values["photos"], update=turn_and_shift),
                Group(name="points", values=values["points"], observed=anchor, sigma=loose),
                self._zoom_group(values),
            ),
            blocks=tuple(blocks),
            datum={"points": datum},
        )

    def _bears(self, camera: int) -> tuple[int, ...]:
        """Return the columns of a lens that the photographs of its camera can tell."""
        if len(self.state.cameras) == 1:
            return STAGES[-1]
        photos = len(np.unique(self.photo[self.camera == camera]))
        # Points that other cameras place tell more of a lens than its own photographs alone.
        if photos >= _ALL_BESIDE_OTHERS:
            return STAGES[-1]
        return stages_for(photos)[-1] or STAGES[1 if photos else 0]

    def _zoom_group(self, values: Values) -> Group:
        zooms = values["zooms"]
        return Group(
            name="zooms", values=zooms, fixed=not self.zooms, observed=np.zeros_like(zooms),
            sigma=np.full_like(zooms, ZOOM_SIGMA),
        )  # fmt: skip

    def _evaluated(self, values: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
        pixels, slopes = evaluate_rays(values, self.photo, self.point, self.middle, self.camera)
        if not self.zooms:
            return pixels, slopes
        centre = self.middle + values["lens"][self.camera, 1:3]
        grown = np.exp(values["zooms"][self.photo])
        pixels = centre + grown * (pixels - centre)
        slopes = {name: grown[:, :, None] * slope for name, slope in slopes.items()}
        slopes["lens"][:, :, 1:3] = np.eye(2)
        return pixels, {**slopes, "zooms": (pixels - centre)[:, :, None]}
