"""How long a survey's bundle takes, against COLMAP's, and whether its covariance tells the truth.

    ./omm exec pip install pycolmap                    # the peer; without it, omm alone is timed
    ./omm exec python bench/survey.py [--networks 1000] [--photos 200 --points 300]

COLMAP is given the same rays, start and camera model (OPENCV: f in both directions, no scale bars,
all rays of one weight) and tells no covariance. Both end at the same minimum: coordinates are
compared after a similarity transformation.

What runs beside counts in the times by the clock. BLAS's threads wait by spinning, which counts in
the times of the CPU, but for OPENBLAS_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from omm_core.adjustment import solve
from omm_core.survey.camera_model import evaluate_rays
from omm_core.survey.cameras import Cameras
from omm_core.survey.datum import free_frame
from omm_core.survey.fitting import Fitting, adjusted
from omm_core.survey.network import STAGES, Network, NetworkState
from omm_core.survey.sighting import Bar, Sighting

LENS = np.array([3010.0, 4.0, -3.0, -0.05, 0.02, 0.0, 1e-4, -5e-5, 1e-4, 2e-5])
MIDDLE = np.array([1499.5, 999.5])
SIGMA_PX = 0.01


def network(
    rng: np.random.Generator, photos: int, points: int, share: float
) -> tuple[np.ndarray, NetworkState, list[Sighting], list[Bar]]:
    """Return true points (T, 3), a start near the truth, what was seen, and two bars."""
    places = rng.uniform(-1, 1, (points, 3)) * [800, 600, 300]
    poses = []
    for i in range(photos):
        around = 2 * np.pi * i / min(photos, 40) + 0.1
        at = np.array([2600 * np.cos(around), 2600 * np.sin(around), 1500.0 + 300 * (i % 5)])
        z = -at / np.linalg.norm(at)
        x = np.cross(z, [0, 0, 1.0]) / np.linalg.norm(np.cross(z, [0, 0, 1.0]))
        roll = Rotation.from_rotvec([0, 0, np.pi / 2 * (i % 4)]).as_matrix()
        turn = Rotation.from_matrix(roll @ np.array([x, np.cross(z, x), z])).as_rotvec()
        poses.append(np.r_[turn, at])
    photo, point = (grid.ravel() for grid in np.mgrid[:photos, :points])
    seen = rng.random(len(photo)) < share
    photo, point = photo[seen], point[seen]
    values = {"lens": LENS[None], "photos": np.array(poses), "points": places}
    pixels = evaluate_rays(values, photo, point, MIDDLE)[0]
    sigma = SIGMA_PX * rng.uniform(0.6, 1.6, len(photo))
    pixels += rng.normal(size=pixels.shape) * sigma[:, None]
    sightings = [
        Sighting(photo=int(i), point=int(p) + 1, center_px=c, covariance_px2=s**2 * np.eye(2))
        for i, p, c, s in zip(photo, point, pixels, sigma, strict=True)
    ]
    bars = []
    for a, b in ((0, 1), (2, 3)):
        length = float(np.linalg.norm(places[a] - places[b]))
        bars.append(
            Bar(ends=(a + 1, b + 1), length_mm=length + rng.normal(0, 0.005), sigma_mm=0.005)
        )
    state = NetworkState(
        lenses=(LENS + np.r_[3.0, 1.0, 1.0, np.zeros(7)])[None],
        cameras=Cameras(focal_px=(LENS[0],)),
        photos={i: p + rng.normal(size=6) * np.repeat([1e-3, 1.0], 3) for i, p in enumerate(poses)},
        points={i + 1: p + rng.normal(0, 1, 3) for i, p in enumerate(places)},
    )
    return places, state, sightings, bars


def squared_error(found: Network, truth: np.ndarray) -> tuple[float, int]:
    """Return eᵀ C⁺ e of all coordinates in the free datum, and its degrees of freedom."""
    measured = found.solution.values["points"]
    turn, _ = Rotation.align_vectors(truth - truth.mean(0), measured - measured.mean(0))
    error = turn.inv().apply(truth - truth.mean(0)) - (measured - measured.mean(0))
    frame = free_frame(measured)
    covariance = frame.covariance(measured, found.solution.covariance_of("points"))
    values, vectors = np.linalg.eigh(covariance)
    inside = (vectors.T @ error.ravel())[6:]
    return float(np.sum(inside**2 / values[6:])), len(inside)


def coverage(count: int) -> None:
    """Print the normalised squared error over many networks, and how often sigma0 is rejected."""
    total, degrees, rejected = 0.0, 0, 0
    for seed in range(count):
        truth, state, sightings, bars = network(np.random.default_rng(seed), 10, 16, 0.9)
        found = adjusted(state, sightings, bars, MIDDLE, STAGES[2:3], 25.0)
        square, dof = squared_error(found, truth)
        total, degrees = total + square, degrees + dof
        redundancy = found.solution.degrees_of_freedom
        statistic = redundancy * found.sigma0**2
        low, high = chi2.ppf([0.025, 0.975], redundancy)
        rejected += not low < statistic < high
    print(
        f"{count} networks: squared error over covariance {total / degrees:.3f};"
        f" sigma0 = 1 rejected at 5 %: {rejected / count:.1%}"
    )


def speed(photos: int, points: int) -> None:
    """Print how long one adjustment with rejection, noise and full covariance takes."""
    _, state, sightings, bars = network(np.random.default_rng(0), photos, points, 0.5)
    fitting = Fitting(state, tuple(sightings), bars, MIDDLE, 36.0)
    values = {
        "lens": state.lenses,
        "photos": np.array(list(state.photos.values())),
        "points": np.array(list(state.points.values())),
        "zooms": np.zeros((photos, 1)),
    }
    wall, cpu = time.perf_counter(), time.process_time()
    solution = solve(fitting.problem(values, STAGES[3]), undetermined=False)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    wall2, cpu2 = time.perf_counter(), time.process_time()
    adjusted(state, sightings, bars, MIDDLE, STAGES[3:])
    wall2, cpu2 = time.perf_counter() - wall2, time.process_time() - cpu2
    print(
        f"{photos} photographs x {points} points, {len(sightings)} rays: bundle with full"
        f" covariance {wall:.2f} s ({cpu:.2f} s of CPU; {solution.iterations} turns); with"
        f" rejection and noise {wall2:.2f} s ({cpu2:.2f} s of CPU)"
    )


def peer(photos: int, points: int) -> None:
    """Print how long COLMAP takes for the same network, and how far its points lie from omm's."""
    try:
        import pycolmap
    except ImportError:
        print("pycolmap is not installed: ./omm exec pip install pycolmap")
        return
    _, state, sightings, _ = network(np.random.default_rng(0), photos, points, 0.5)
    sightings = [replace(s, covariance_px2=SIGMA_PX**2 * np.eye(2)) for s in sightings]
    fitting = Fitting(state, tuple(sightings), [], MIDDLE, 1e9)
    values = {
        "lens": np.array(state.lenses),
        "photos": np.array(list(state.photos.values())),
        "points": np.array(list(state.points.values())),
        "zooms": np.zeros((photos, 1)),
    }
    values["lens"][0, 3:] = 0.0
    wall, cpu = time.perf_counter(), time.process_time()
    ours = solve(fitting.problem(values, (*STAGES[2], 8)), undetermined=False)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    theirs = _reconstruction(pycolmap, values, sightings)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point, options.print_summary = True, False
    options.ceres.solver_options.gradient_tolerance = 1e-10
    options.ceres.solver_options.min_relative_decrease = 1e-9
    wall2, cpu2 = time.perf_counter(), time.process_time()
    pycolmap.bundle_adjustment(theirs, options)
    wall2, cpu2 = time.perf_counter() - wall2, time.process_time() - cpu2
    found = ours.values["points"]
    there = np.array([theirs.points3D[i].xyz for i in sorted(theirs.points3D)])
    turn, _ = Rotation.align_vectors(found - found.mean(0), there - there.mean(0))
    turned = turn.apply(there - there.mean(0))
    turned *= np.sum(turned * (found - found.mean(0))) / np.sum(turned**2)
    away = np.abs(turned - (found - found.mean(0))).max()
    sigma = np.sqrt(np.diag(ours.covariance_of("points")))
    print(
        f"the same without bars: omm {wall:.2f} s ({cpu:.2f} s of CPU) with full covariance,"
        f" COLMAP {pycolmap.__version__} {wall2:.2f} s ({cpu2:.2f} s of CPU) without; points differ"
        f" by {away * 1e3:.1g} um at most (their sigma: {np.median(sigma) * 1e3:.2f} um)"
    )


def _reconstruction(pycolmap: Any, values: dict[str, np.ndarray], sightings: list[Sighting]) -> Any:
    """Return the network as COLMAP has it, before it is adjusted."""
    f, cl, rw = values["lens"][0, :3]
    found = pycolmap.Reconstruction()
    width, height = (2 * MIDDLE + 1).astype(int)
    camera = pycolmap.Camera(
        camera_id=1, model="OPENCV", width=int(width), height=int(height),
        params=[f, f, MIDDLE[0] + cl, MIDDLE[1] + rw, 0.0, 0.0, 0.0, 0.0],
    )  # fmt: skip
    found.add_camera_with_trivial_rig(camera)
    tracks: dict[int, Any] = {}
    for photo, pose in enumerate(values["photos"]):
        own = [s for s in sightings if s.photo == photo]
        turn = Rotation.from_rotvec(pose[:3])
        image = pycolmap.Image(
            name=f"{photo}", keypoints=np.array([s.center_px for s in own]), camera_id=1,
            image_id=photo + 1,
        )  # fmt: skip
        shift = -turn.apply(pose[3:])
        found.add_image_with_trivial_frame(
            image, pycolmap.Rigid3d(pycolmap.Rotation3d(turn.as_quat()), shift)
        )
        for k, s in enumerate(own):
            tracks.setdefault(s.point, pycolmap.Track()).add_element(photo + 1, k)
    for number in sorted(tracks):
        found.add_point3D(values["points"][number - 1], tracks[number])
    return found


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--networks", type=int, default=0)
    parser.add_argument("--photos", type=int, default=200)
    parser.add_argument("--points", type=int, default=300)
    arguments = parser.parse_args()
    if arguments.networks:
        coverage(arguments.networks)
    else:
        speed(arguments.photos, arguments.points)
        peer(arguments.photos, arguments.points)


if __name__ == "__main__":
    main()
