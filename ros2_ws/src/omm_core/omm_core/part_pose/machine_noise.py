"""How exact a machine may be: the grid on which its noise is estimated, and the priors.

Three numbers describe a machine (docs/statistics.md): how well a stop repeats (each axis, each
stop anew), how large the errors of its geometry are, and over what length these change. Whatever
is not declared is a coordinate of the grid; each point of it is one machine that there might be,
with the probability that it has before anything was measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.grid_kernels import Machines
from omm_core.part_pose.observation import SolveOptions

Array = NDArray[np.float64]

_STOPS_MM = np.array([0.1, 0.4, 1.0, 2.0, 3.5, 6.0, 10.0, 16.0, 25.0]) / 1e3
_GEOMETRY_MM = np.array([0.0, 2.0, 5.0, 9.0, 15.0, 24.0, 40.0, 63.0, 100.0]) / 1e3
_LENGTHS = np.array([0.15, 0.35, 0.75])  # of the diagonal of the stops
_LENGTH_PRIOR = np.array([0.1, 0.45, 0.45])
_STOP_FLOOR_MM = 0.001  # the density is 1 / (σ + floor)
_GEOMETRY_FLOOR_MM = 0.001  # below it the density 1/σ is level
_STEP = 1.6  # between levels, where the grid is made longer
_IMAGE_SCALES = np.array([1.0, 2.0, 3.5, 6.0])  # of what the detector says of itself
_IMAGE_PRIOR = np.array([0.4, 0.25, 0.2, 0.15])
_APART = 1000  # between the coordinates of two grids
WORST_MM = float(_GEOMETRY_MM[-1])


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseGrid:
    """Machines that there might be.

    Attributes
    ----------
    image_scale, stop_sigma_mm, geometry_sigma_mm : (P,) arrays
    length_index : (P,) array
        Which of ``lengths_mm`` the geometry's errors of a point have.
    lengths_mm : (L,) array
    log_prior : (P,) array
    coordinates : (P, 4) array
        Where a point is in the grid: numbers of its image scale, stop, geometry, length.
    estimated : tuple of str
        What is not declared, by the names of machine.yaml.
    """

    image_scale: Array
    stop_sigma_mm: Array
    geometry_sigma_mm: Array
    length_index: NDArray[np.int64]
    lengths_mm: Array
    log_prior: Array
    coordinates: NDArray[np.int64]
    estimated: tuple[str, ...]

    def __len__(self) -> int:
        """Return P."""
        return len(self.log_prior)

    def machines(self) -> Machines:
        """Return the grid as the kernels take it."""
        return Machines(
            scales=self.image_scale, stops=self.stop_sigma_mm, geometry=self.geometry_sigma_mm,
            lengths=self.length_index, log_prior=self.log_prior,
        )  # fmt: skip

    def only(self, points: NDArray[np.int64]) -> NoiseGrid:
        """Return the grid of some points; their prior is left as it is."""
        names = ("image_scale", "stop_sigma_mm", "geometry_sigma_mm", "length_index",
                 "log_prior", "coordinates")  # fmt: skip
        return replace(self, **{name: getattr(self, name)[points] for name in names})


def noise_grid(options: SolveOptions, diagonal_mm: float, *, scale_image: bool) -> NoiseGrid:
    """Return the grid for what the options do not declare.

    Parameters
    ----------
    diagonal_mm : float
        Of the box of the commanded stops.
    scale_image : bool
        Whether the detector's own word on its noise is doubted. Needless where each image shows
        one target: what is said too little of the centre is then taken for the stop's.
    """
    lengths = geometry_lengths(options, diagonal_mm)
    if options.geometry_sigma_mm == 0.0:
        lengths = lengths[:1]
    grid = _grid_of(
        options.stop_sigma_mm, options.geometry_sigma_mm, options.worst_machine_mm, len(lengths),
        scale_image=scale_image,
    )  # fmt: skip
    estimated = [
        name
        for name in ("stop_sigma_mm", "geometry_sigma_mm", "geometry_length_mm")
        if getattr(options, name) is None
    ]
    return replace(grid, lengths_mm=lengths, estimated=tuple(estimated))


@lru_cache(maxsize=64)
def _grid_of(
    stop_sigma_mm: float | None,
    geometry_sigma_mm: float | None,
    worst_mm: float,
    lengths: int,
    *,
    scale_image: bool,
) -> NoiseGrid:
    """Return the grid but for its lengths: the same for all problems, and made once."""
    stops, stop_prior = _stops(stop_sigma_mm, worst_mm)
    geometry, geometry_prior = _geometry(geometry_sigma_mm, worst_mm)
    scales, scale_prior = (
        (_IMAGE_SCALES, _IMAGE_PRIOR) if scale_image else (_IMAGE_SCALES[:1], np.ones(1))
    )
    sizes = [np.arange(size) for size in (len(scales), len(stops), len(geometry), lengths)]
    i, s, g, k = (index.ravel() for index in np.meshgrid(*sizes, indexing="ij"))
    # Without geometry errors their length is nothing: one point does for all lengths.
    one = (geometry[g] > 0.0) | (k == 0)
    i, s, g, k = i[one], s[one], g[one], k[one]
    length_prior = _LENGTH_PRIOR if lengths == len(_LENGTH_PRIOR) else np.ones(lengths)
    weight = np.where(geometry[g] > 0.0, length_prior[k], 1.0)
    prior = scale_prior[i] * stop_prior[s] * geometry_prior[g] * weight
    return NoiseGrid(
        image_scale=scales[i],
        stop_sigma_mm=stops[s],
        geometry_sigma_mm=geometry[g],
        length_index=k.astype(np.int64),
        lengths_mm=np.zeros(lengths),
        log_prior=np.log(prior / prior.sum()),
        coordinates=np.stack([i, s, g, k], axis=1),
        estimated=(),
    )


def both_grids(told: NoiseGrid, free: NoiseGrid) -> NoiseGrid:
    """Return the grid of two, with even odds between them."""
    return NoiseGrid(
        image_scale=np.concatenate([told.image_scale, free.image_scale]),
        stop_sigma_mm=np.concatenate([told.stop_sigma_mm, free.stop_sigma_mm]),
        geometry_sigma_mm=np.concatenate([told.geometry_sigma_mm, free.geometry_sigma_mm]),
        length_index=np.concatenate([told.length_index, free.length_index + len(told.lengths_mm)]),
        lengths_mm=np.concatenate([told.lengths_mm, free.lengths_mm]),
        log_prior=np.concatenate([told.log_prior, free.log_prior]) - np.log(2.0),
        coordinates=np.concatenate([told.coordinates, free.coordinates + _APART]),
        estimated=told.estimated,
    )


def geometry_lengths(options: SolveOptions, diagonal_mm: float) -> Array:
    """Return the lengths over which the geometry may change, the shortest first, mm."""
    if options.geometry_length_mm is not None:
        return np.array([options.geometry_length_mm])
    return np.asarray(_LENGTHS * max(diagonal_mm, 1.0))


def _stops(declared_mm: float | None, worst_mm: float) -> tuple[Array, Array]:
    """Return the levels of stops, and their prior."""
    if declared_mm is not None:
        return np.array([declared_mm]), np.ones(1)
    levels = _levels(_STOPS_MM, worst_mm / WORST_MM)
    return levels, np.gradient(levels) / (levels + _STOP_FLOOR_MM)


def _geometry(declared_mm: float | None, worst_mm: float) -> tuple[Array, Array]:
    """Return the levels of geometry errors, and their prior."""
    if declared_mm is not None:
        return np.array([declared_mm]), np.ones(1)
    levels = _levels(_GEOMETRY_MM, worst_mm / WORST_MM)
    prior = np.gradient(levels) / np.maximum(levels, _GEOMETRY_FLOOR_MM)
    prior[0] /= 2.0
    return levels, prior


def _levels(usual_mm: Array, scale: float) -> Array:
    """Return the levels up to the largest times ``scale``: cut, or longer than usual."""
    limit = usual_mm[-1] * scale * (1.0 + 1e-9)
    levels = list(usual_mm[usual_mm <= limit])
    while levels[-1] >= usual_mm[-1] and levels[-1] * _STEP <= limit:
        levels.append(levels[-1] * _STEP)
    while len(levels) < 2:
        levels.append(usual_mm[len(levels)])
    return np.array(levels)


@dataclass(frozen=True, kw_only=True)
class Level:
    """One number of the machine's noise: the median, and what holds 90 % of the probability."""

    median: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class MachineNoise:
    """How large a machine's errors are, as declared or as a run shows; mm.

    Attributes
    ----------
    stop_sigma_mm, geometry_sigma_mm, geometry_length_mm : Level
    image_scale : float
        How much larger the centres' noise is than the detector says; 1 where not doubted.
    estimated : tuple of str
        What is not declared.
    """

    stop_sigma_mm: Level
    geometry_sigma_mm: Level
    geometry_length_mm: Level
    image_scale: float
    estimated: tuple[str, ...]


def summarise(grid: NoiseGrid, weight: Array) -> MachineNoise:
    """Return the noise in few numbers, given the probability of each machine of the grid."""
    return MachineNoise(
        stop_sigma_mm=_level(grid.stop_sigma_mm, weight),
        geometry_sigma_mm=_level(grid.geometry_sigma_mm, weight),
        geometry_length_mm=_level(
            grid.lengths_mm[grid.length_index], weight * (grid.geometry_sigma_mm > 0.0)
        ),
        image_scale=_level(grid.image_scale, weight).median,
        estimated=grid.estimated,
    )


def _level(values: Array, weight: Array) -> Level:
    if not weight.sum() > 0.0:
        return Level(median=float(values[0]), low=float(values[0]), high=float(values[0]))
    levels, index = np.unique(values, return_inverse=True)
    share = np.cumsum(np.bincount(index.ravel(), weights=weight))
    at = [int(np.searchsorted(share, q * share[-1])) for q in (0.05, 0.5, 0.95)]
    low, median, high = (float(levels[min(i, len(levels) - 1)]) for i in at)
    return Level(median=median, low=low, high=high)
