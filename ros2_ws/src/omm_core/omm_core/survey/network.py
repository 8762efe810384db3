"""The free network of photographs, points and scale bars, with self-calibration."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Solution
from omm_core.survey.cameras import Cameras
from omm_core.survey.circles import Circle
from omm_core.survey.noise import RayNoise
from omm_core.survey.sighting import Bar, Sighting

Array = NDArray[np.float64]

FEWEST_RAYS = 3
FEWEST_IN_PHOTO = 4
BAD_SHARE = 0.4  # of a photograph's rays, from which on it is left out
CONTRADICTS = "its rays contradict each other and there are too few to tell which is wrong"
REJECTION = 16.0  # t2 of a ray: about 4 sigma
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
    cameras : Cameras
    noise : RayNoise
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
    few_rays : tuple of int
        Coded targets that too few of the photographs show to have a place.
    words : tuple of str
        What else must be told.
    """

    photos: dict[int, int]
    points: dict[int, int]
    solution: Solution
    cameras: Cameras
    noise: RayNoise
    sightings: tuple[Sighting, ...]
    used: NDArray[np.bool_]
    bars: tuple[Bar, ...]
    middle_px: Array
    t2: Array
    circles: dict[int, Circle] = field(default_factory=dict)
    diameters_mm: dict[str, float] = field(default_factory=dict)
    left_out_points: dict[int, str] = field(default_factory=dict)
    left_out_photos: dict[int, str] = field(default_factory=dict)
    few_rays: tuple[int, ...] = ()
    words: tuple[str, ...] = ()

    @property
    def lens(self) -> Array:
        """Return the first camera's lens (10,), see `camera_model.PARAMETERS`."""
        return self.solution.values["lens"][0]

    def lens_of(self, photo: int) -> Array:
        """Return the lens (10,) of a photograph's camera."""
        return self.solution.values["lens"][self.cameras.row(photo)]

    @property
    def rms_px(self) -> float:
        """Return the root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.solution.residuals["rays"][self.used] ** 2)))

    @property
    def sigma0(self) -> float:
        """Return how many times the detector's standard deviation the rays show."""
        return self.noise.sigma0(detector_covariances(self.sightings), self.kinds, self.used)

    @property
    def sigma0_by(self) -> dict[str, float]:
        """Return the same by kind of target and, where there are several, by camera."""
        by = {}
        for kind in np.unique(self.kinds):
            rays = self.used & (self.kinds == kind)
            if rays.any():
                by[str(kind)] = self.noise.sigma0(
                    detector_covariances(self.sightings), self.kinds, rays
                )
        return by

    @property
    def kinds(self) -> NDArray[np.str_]:
        """Return whose noise each ray shares."""
        return noise_kinds(self.sightings, self.cameras)

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
    """Where an adjustment begins: places by number, lenses (C, 10), and what is known."""

    lenses: Array
    cameras: Cameras
    photos: dict[int, Array]
    points: dict[int, Array]
    noise: RayNoise = field(default_factory=RayNoise)
    declared_mm: dict[str, float] = field(default_factory=dict)
    circles: dict[int, Circle] = field(default_factory=dict)
    diameters_mm: dict[str, float] = field(default_factory=dict)

    def lens_of(self, photo: int) -> Array:
        """Return the lens (10,) of a photograph's camera."""
        return self.lenses[self.cameras.row(photo)]


def state_of(network: Network, declared_mm: dict[str, float]) -> NetworkState:
    """Return where a network stands, to go on from."""
    values = network.solution.values
    return NetworkState(
        lenses=values["lens"].copy(),
        cameras=network.cameras,
        photos={n: values["photos"][row].copy() for n, row in network.photos.items()},
        points={n: values["points"][row].copy() for n, row in network.points.items()},
        noise=network.noise, declared_mm=declared_mm, circles=network.circles,
        diameters_mm=network.diameters_mm,
    )  # fmt: skip


def stages_for(photos: int) -> tuple[tuple[int, ...], ...]:
    """Return which stages so many photographs can bear."""
    return STAGES if photos >= PHOTOS_FOR_ALL else STAGES[:3] if photos >= 4 else STAGES[:1]


def noise_kinds(sightings: tuple[Sighting, ...], cameras: Cameras) -> NDArray[np.str_]:
    """Return whose noise each ray shares: its kind's, where there are several in its camera."""
    if len(cameras) == 1:
        return np.array([s.kind for s in sightings])
    return np.array([f"{s.kind}, {cameras.names[cameras.row(s.photo)]}" for s in sightings])


def detector_covariances(sightings: tuple[Sighting, ...]) -> Array:
    """Return what the detector thinks of the rays, (M, 2, 2) px²."""
    return np.array([s.covariance_px2 for s in sightings]).reshape(-1, 2, 2)
