"""How far blunders among the rays of real photographs move a survey's coordinates.

    ./omm exec python bench/survey_blunders.py FOLDER [--draws 10] [--share 0.05]

That share of the coded targets' image points is put off by 0.03 to 100 px (drawn evenly over the
logarithm).
Each coordinate is compared with the solution of all good rays, in its standard deviations; beside
it the solution that knows which rays are bad and leaves just these out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from omm_core.errors import MeasurementError
from omm_core.files.survey import load_survey
from omm_core.survey import Bar, Network, Sighting, solve_network
from omm_core.survey.sighting import sighting_of_target
from omm_core.targets.plain import PlainDot
from omm_runs.photographs import look_at_all

Array = NDArray[np.float64]

_SIZES_PX = (0.03, 100.0)
_SAME_MM = 2.0  # plain targets have no number


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """What was seen in the photographs of a folder with one camera."""

    sightings: list[Sighting]
    dots: dict[int, tuple[PlainDot, ...]]
    bars: list[Bar]
    focal_px: float
    size_px: tuple[int, int]

    def solved(self, sightings: list[Sighting]) -> Network:
        """Return the network of some of the rays."""
        return solve_network(sightings, self.bars, self.focal_px, self.size_px, self.dots)


def seen_in(folder: Path) -> Survey:
    """Find the targets in a folder's photographs."""
    given = load_survey(folder)
    seen = look_at_all(given.photos, given.target_family)
    if given.focal_length_px is None or given.size_px is None:
        raise SystemExit(f"Expected focal length and size of one camera in {folder}/survey.yaml.")
    return Survey(
        sightings=[sighting_of_target(i, t) for i, s in enumerate(seen) for t in s.targets],
        dots={i: s.dots for i, s in enumerate(seen)},
        bars=[
            Bar(ends=b.ends, length_mm=b.length_mm, sigma_mm=b.sigma_mm) for b in given.scale_bars
        ],
        focal_px=given.focal_length_px,
        size_px=given.size_px,
    )


def worst_in_sigma(network: Network, clean: Network) -> tuple[float, int]:
    """Return the largest change of a coordinate over its clean sigma, and targets not in clean."""
    coded = [n for n in network.points if n > 0 and n in clean.points]
    here = np.array([network.xyz_mm(n) for n in coded])
    there = np.array([clean.xyz_mm(n) for n in coded])
    turn, _ = Rotation.align_vectors(there - there.mean(0), here - here.mean(0))
    plain = [n for n in clean.points if n < 0]
    near = cKDTree([clean.xyz_mm(n) for n in plain]) if plain else None
    sigma = np.sqrt(np.diag(clean.solution.covariance_of("points"))).reshape(-1, 3)
    worst, foreign = 0.0, 0
    for number in network.points:
        place = turn.apply(network.xyz_mm(number) - here.mean(0)) + there.mean(0)
        same = number
        if number < 0 and near is not None:
            away, index = near.query(place)
            same = plain[index] if away < _SAME_MM else 0
        if same not in clean.points:
            foreign += 1
            continue
        off = np.abs(place - clean.xyz_mm(same)) / sigma[clean.points[same]]
        worst = max(worst, float(off.max()))
    return worst, foreign


def spoilt(
    sightings: Sequence[Sighting], share: float, random: np.random.Generator
) -> tuple[list[Sighting], list[Sighting]]:
    """Return all rays with blunders among them, and the good ones alone."""
    every, good = [], []
    for sighting in sightings:
        if random.random() >= share:
            every.append(sighting)
            good.append(sighting)
            continue
        size_px = np.exp(random.uniform(*np.log(_SIZES_PX)))
        along = random.uniform(0.0, 2.0 * np.pi)
        off = size_px * np.array([np.cos(along), np.sin(along)])
        every.append(replace(sighting, center_px=sighting.center_px + off))
    return every, good


def main() -> None:
    """Draw blunders, and print how far they move what is measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--share", type=float, default=0.05)
    arguments = parser.parse_args()
    survey = seen_in(arguments.folder)
    clean = survey.solved(survey.sightings)
    print(f"{len(clean.points)} targets; worst change / sigma (known blunders left out), targets")
    for seed in range(arguments.draws):
        every, good = spoilt(survey.sightings, arguments.share, np.random.default_rng(seed))
        told = [f"{seed:3d}: {len(every) - len(good):3d} blunders"]
        for rays in (every, good):
            try:
                network = survey.solved(rays)
            except MeasurementError as error:
                told.append(str(error))
                continue
            worst, foreign = worst_in_sigma(network, clean)
            told.append(f"{worst:5.2f} in {len(network.points)}, {foreign} that are not there")
        print("; ".join(told), flush=True)


if __name__ == "__main__":
    main()
