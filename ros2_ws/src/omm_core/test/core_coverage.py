"""Simulated measurements on machines that err: how many errors lie inside U, and how wide U is.

bench/coverage.py makes the whole table of it, test_coverage.py a small one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from core_cells import BACKLASH_RAD, PAPER_CALIBRATION
from known_noise import KnownNoise, KnownNoiseResult, solve_knowing_all

from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform, spindle_T_taper
from omm_core.imaging.circle import CircleCentre, project_circles
from omm_core.machine_errors import draw_geometry, draw_stop_noise, geometry_covariance, own_pose
from omm_core.part_pose import Observation, Solution, SolveOptions, solve

DETECTOR_SIGMA_PX = 0.005
HORIZONTAL = RigidTransform.from_euler_xyz_rad(np.pi / 2, 0.0, 0.0)
# Distance: stereo base, and where the targets are seen on average off the spindle's axis.
VIEWS = {300: (120.0, (-15.0, -35.0)), 150: (60.0, (5.0, -8.0))}
IDS = (42, 40, 8, 122, 17, 63, 91, 134)


@dataclass(frozen=True, kw_only=True)
class CoverageCell:
    """One cell of the table: how the machine errs and what is measured.

    Attributes
    ----------
    stop_um, geometry_um : float
        Standard deviations of stops and geometry.
    correlation : float
        Length of the geometry's errors over the diagonal of the stops.
    targets : int
        4 or 6 on 1.5 x 1 m, or 8 on 10 x 3 m (the paper's industrial use); two images each.
    distance_mm : int
        Of the camera, 300 or 150.
    detector : float
        How many times worse the detector is than it says.
    target_um : float
        Standard deviation of the targets' coordinates, declared in the part file.
    declared : bool
        Whether the solver is told stops and geometry.
    """

    stop_um: float
    geometry_um: float
    correlation: float = 1.0
    targets: int = 4
    distance_mm: int = 300
    detector: float = 1.0
    target_um: float = 0.0
    declared: bool = False

    @property
    def name(self) -> str:
        """What ``--cells`` matches."""
        words = [
            f"stops{self.stop_um:g}", f"geometry{self.geometry_um:g}", f"l{self.correlation:g}",
            f"t{self.targets}", f"{self.distance_mm}mm",
        ]  # fmt: skip
        words += [f"detector{self.detector:g}"] if self.detector != 1.0 else []
        words += [f"target{self.target_um:g}"] if self.target_um else []
        return "-".join(words + ["declared"] * self.declared)

    @property
    def bump_mm(self) -> float:
        """How far a bumped target must be off to be found (issue: 4 targets, more)."""
        return 0.5 if self.targets == 4 else 0.2


def all_cells() -> tuple[CoverageCell, ...]:
    """Return the cells of the table; with geometry 0 the correlation says nothing."""
    grid = [
        CoverageCell(
            stop_um=stop, geometry_um=geometry, correlation=correlation, targets=targets,
            distance_mm=distance,
        )
        for targets, distance, stop, geometry, correlation in product(
            (4, 6, 8), (150, 300), (0.0, 1.0, 3.0, 8.0), (0.0, 15.0, 40.0), (0.4, 1.0, 3.0)
        )
        if (geometry > 0.0 or correlation == 1.0) and not (targets == 8 and distance == 300)
    ]  # fmt: skip
    worse = [replace(cell, detector=4.0) for cell in grid if cell.stop_um == 3.0]
    declared = [replace(cell, declared=True) for cell in grid if cell.stop_um > 0.0]
    return (*grid, *worse, *declared)


def any_cell(seed: int) -> CoverageCell:
    """Return a machine out of all that must be solved: nobody tuned anything to it."""
    random = np.random.default_rng([seed, 99])
    return CoverageCell(
        stop_um=float(random.uniform(0.0, 20.0)),
        geometry_um=float(random.uniform(0.0, 50.0)),
        correlation=float(np.exp(random.uniform(np.log(0.2), np.log(4.0)))),
        targets=int(random.choice([4, 6, 8])),
        distance_mm=150,
        detector=float(random.uniform(1.0, 5.0)),
        target_um=float(random.choice([0.0, random.uniform(0.0, 100.0)])),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """One simulated measurement with its truth."""

    part: Part
    observations: tuple[Observation, ...]
    absolute: np.ndarray
    own: np.ndarray
    best: KnownNoiseResult
    length_mm: float


def draw(cell: CoverageCell, random: np.random.Generator, *, bumped: int | None = None) -> Drawn:
    """Draw a measurement; ``bumped`` is the row of a target that is not where it should be."""
    told = _part(cell)
    pose, gamma_s = _pose(random), float(random.uniform(-0.5, 0.5) * BACKLASH_RAD)
    R = HORIZONTAL if cell.targets == 8 else RigidTransform.identity()
    spindles = _stops(cell, told, pose, R.rotation, random)
    places = np.array([s.translation_mm for s in spindles])
    length = cell.correlation * float(np.linalg.norm(np.ptp(places, axis=0)))
    geometry = draw_geometry(random, places, cell.geometry_um / 1e3, length)
    stops = draw_stop_noise(random, len(places), cell.stop_um / 1e3)
    X = np.array([t.xyz_mm for t in told.targets])
    true = X + random.normal(0.0, 1.0, X.shape) * cell.target_um / 1e3
    if bumped is not None:
        direction = random.normal(size=3)
        true[bumped] += cell.bump_mm * direction / np.linalg.norm(direction)
    image_of = np.arange(len(places))
    target_of = image_of // 2
    noise_px = DETECTOR_SIGMA_PX * cell.detector
    exact = _centres(told, true[target_of], target_of, spindles, geometry + stops, pose, gamma_s)
    centres = exact + random.normal(0.0, noise_px, exact.shape)
    absolute = _theta(pose, gamma_s)
    noise = KnownNoise(
        image_sigma_px=noise_px, stop_sigma_mm=cell.stop_um / 1e3,
        geometry=geometry_covariance(places, cell.geometry_um / 1e3, length),
        target_sigma_mm=cell.target_um / 1e3,
    )  # fmt: skip
    best = solve_knowing_all(
        absolute, X, image_of, target_of, spindles, PAPER_CALIBRATION,
        centres - _eccentricity(told, X, target_of, spindles, pose, gamma_s), noise,
    )  # fmt: skip
    return Drawn(
        part=told,
        observations=tuple(
            Observation(
                stamp_ns=(s + 1) * 1_000_000_000,
                target_id=told.targets[t].id,
                center_px=centre,
                covariance_px2=np.eye(2) * DETECTOR_SIGMA_PX**2,
                machine_T_spindle=spindles[s],
            )
            for s, t, centre in zip(image_of, target_of, centres)
        ),
        absolute=absolute,
        own=_theta(own_pose(pose, X, target_of, geometry), gamma_s),
        best=best,
        length_mm=length,
    )


def _part(cell: CoverageCell) -> Part:
    if cell.targets == 8:
        x, z = np.array([0, 3300, 6700, 10000, 10000, 6700, 3300, 0]), np.repeat([0.0, 3000.0], 4)
        places = np.column_stack([x, [2.4, -1.7, 3.1, -2.2, 1.9, -3.6, 0.8, -0.9], z])
    else:
        x = [0, 1500, 1500, 0] if cell.targets == 4 else [0, 750, 1500, 1500, 750, 0]
        y = np.repeat([0.0, 1000.0], cell.targets // 2)
        places = np.column_stack([x, y, [3.75, 11.92, 8.27, -8.24, 5.1, -2.3][: cell.targets]])
    sigma = np.full(3, cell.target_um / 1e3)
    normal = HORIZONTAL.rotation[:, 2] if cell.targets == 8 else np.array([0.0, 0.0, 1.0])
    return Part(
        name=cell.name,
        target_family="metashape12",
        targets=tuple(
            Target(
                id=i, xyz_mm=xyz, dot_diameter_mm=8.0 if cell.targets < 8 else 6.0, normal=normal,
                sigma_xyz_mm=sigma,
            )
            for i, xyz in zip(IDS, places)
        ),
    )  # fmt: skip


def _pose(random: np.random.Generator) -> RigidTransform:
    return RigidTransform.from_euler_xyz_rad(
        *random.normal(0.0, 2e-3, 3), translation_mm=random.uniform(-150.0, 150.0, 3)
    )


def _stops(cell, part, pose, R, random) -> list[RigidTransform]:
    """Return the commanded poses: two a target, one stereo base apart, roughly over it."""
    base, offset = VIEWS[cell.distance_mm]
    depth = PAPER_CALIBRATION.taper_T_camera.translation_mm[2] - cell.distance_mm
    return [
        RigidTransform(
            rotation=R,
            translation_mm=np.round(
                pose @ target.xyz_mm
                - R @ np.array([offset[0] - side * base, offset[1], depth])
                + random.normal(0.0, 5.0, 3),
                3,
            ),
        )
        for target in part.targets
        for side in (-0.5, 0.5)
    ]


def _centres(part, X, target_of, spindles, errors, pose, gamma_s) -> np.ndarray:
    """Return what the camera sees, (N, 2), with the spindle off its commanded places."""
    holder = spindle_T_taper(gamma_s) @ PAPER_CALIBRATION.taper_T_camera
    centres, normals = np.empty_like(X), np.empty_like(X)
    for k, (t, spindle, error) in enumerate(zip(target_of, spindles, errors)):
        true = replace(spindle, translation_mm=spindle.translation_mm + error)
        camera_T_part = (true @ holder).inverse() @ pose
        centres[k] = camera_T_part @ X[k]
        normals[k] = camera_T_part.rotation @ part.targets[t].normal
    diameters = [part.targets[t].dot_diameter_mm for t in target_of]
    return project_circles(
        PAPER_CALIBRATION.lens, centres, normals, diameters, CircleCentre.OUTLINE
    )


def _eccentricity(part, X, target_of, spindles, pose, gamma_s) -> np.ndarray:
    """Return by how much the dots' images lie off those of their centres, (N, 2)."""
    still = np.zeros((len(spindles), 3))
    dots = _centres(part, X[target_of], target_of, spindles, still, pose, gamma_s)
    small = replace(part, targets=tuple(replace(t, dot_diameter_mm=1e-3) for t in part.targets))
    return dots - _centres(small, X[target_of], target_of, spindles, still, pose, gamma_s)


def _theta(pose: RigidTransform, gamma_s: float) -> np.ndarray:
    return np.array([*pose.euler_xyz_rad(), *pose.translation_mm, gamma_s])


def options_of(cell: CoverageCell, drawn: Drawn) -> SolveOptions:
    """Return what the solver is told of a cell's machine."""
    if not cell.declared:
        return SolveOptions()
    return SolveOptions(
        stop_sigma_mm=cell.stop_um / 1e3,
        geometry_sigma_mm=cell.geometry_um / 1e3,
        geometry_length_mm=drawn.length_mm,
    )


def statements(solution: Solution) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Return (θ, U) in the machine's own coordinates, and absolute."""
    return tuple((s.theta, s.expanded_uncertainty) for s in (solution.own, solution.absolute))


OWN, ABSOLUTE = 0, 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Tally:
    """What came out of runs of one cell.

    Attributes
    ----------
    runs, refused, lost : int
        Runs; of these without a solution; of these (clean ones) with anything left out.
    inside : (2, 7) array
        How many errors of own and absolute θ lay inside U.
    widths : (solved, 2, 7) array
        U over the U of a solver that knows all noise, of each run that was solved.
    known_inside : (2, 7) array
        Errors of that solver inside its own U: what the harness itself is checked by.
    """

    runs: int
    refused: int
    lost: int
    inside: np.ndarray
    widths: np.ndarray
    known_inside: np.ndarray

    def __add__(self, other: Tally) -> Tally:
        names = ("runs", "refused", "lost", "inside", "known_inside")
        widths = np.concatenate([self.widths, other.widths])
        return Tally(widths=widths, **{n: getattr(self, n) + getattr(other, n) for n in names})


def measure(cell: CoverageCell, seed: int) -> Tally:
    """Draw a clean measurement, solve it, and say what of it lay inside U."""
    drawn = draw(cell, _random(cell, seed, 0))
    best = drawn.best
    truths = (drawn.own, drawn.absolute)
    known = ((best.own, best.own_covariance), (best.absolute, best.absolute_covariance))
    known_U = [2.0 * np.sqrt(np.diag(covariance)) for _, covariance in known]
    known_inside = np.array(
        [np.abs(theta - true) < U for (theta, _), true, U in zip(known, truths, known_U)]
    )
    solution = solve(drawn.observations, drawn.part, PAPER_CALIBRATION, options_of(cell, drawn))
    inside, width = np.zeros((2, 7)), np.zeros((2, 7))
    if solution.determined:
        for k, (theta, U) in enumerate(statements(solution)):
            inside[k] = np.abs(theta - truths[k]) < U
            width[k] = U / known_U[k]
    return Tally(
        runs=1,
        refused=int(not solution.determined),
        lost=int(not np.all(solution.used)),
        inside=inside,
        widths=width[None] if solution.determined else np.empty((0, 2, 7)),
        known_inside=known_inside.astype(float),
    )


WRONGS = ("bumped", "other pose", "misread")


def finds(cell: CoverageCell, wrong: str, seed: int) -> bool:
    """Draw a measurement with one thing wrong; say whether it is found and rightly named.

    Two named because they cannot be told apart count where the right one is among them.
    """
    random = _random(cell, seed, 1 + WRONGS.index(wrong))
    row = int(random.integers(cell.targets))
    drawn = draw(cell, random, bumped=row if wrong == "bumped" else None)
    seen = list(drawn.observations)
    index, other = random.choice(len(seen), 2, replace=False)
    right = np.zeros(len(seen), dtype=bool)
    if wrong == "bumped":
        right = np.array([o.target_id == drawn.part.targets[row].id for o in seen])
        words = [f"target {drawn.part.targets[row].id} is "]
    elif wrong == "other pose":
        seen[index] = replace(seen[index], machine_T_spindle=seen[other].machine_T_spindle)
        right[index] = True
        words = [f"{seen[index].stamp_ns} ns) is not where it was taken"]
    else:
        others = [t.id for t in drawn.part.targets if t.id != seen[index].target_id]
        read_as = int(random.choice(others))
        words = [f"target {seen[index].target_id} was read as {read_as}"]
        seen[index] = replace(seen[index], target_id=read_as)
        right[index] = True
    solution = solve(seen, drawn.part, PAPER_CALIBRATION, options_of(cell, drawn))
    # Solutions hold observations in the order (stamp, target): here, that of the stops.
    named = any(w in said for w in words for said in (*solution.findings, *solution.missing))
    if not solution.determined:
        return named
    return named and bool(np.array_equal(~solution.used, right))


def _random(cell: CoverageCell, seed: int, kind: int) -> np.random.Generator:
    return np.random.default_rng([seed, kind, *cell.name.encode()])
