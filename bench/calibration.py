"""Calibrating a camera: against scipy and OpenCV in one run, against truth, and against itself.

python bench/calibration.py [--draws 40] [--sets ../shared/data/calibration]

1. The paper's grid (Table 1's camera, 10 planes of 9 x 7 dots, 75 to 1110 mm, 1 um, 0.015 px):
   CPU time and largest error of the projection of `omm`, of scipy's least_squares on the same model
   and of OpenCV's calibrateCamera (plumb_bob).
2. Ten repeats of it: mean and scatter of each parameter beside Table 1 and the sigma told.
3. Squared errors over the covariance, over simulated sets of both kinds (13 is right).
4. Sets with a truth.json in a folder: largest error in sigma, and of the projection, px.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from omm_core.camera_calibration.cmm import calibrate_by_places
from omm_core.camera_calibration.machine import calibrate_by_run
from omm_core.camera_calibration.model import PARAMETERS, Sensor, project_with_derivatives
from omm_core.camera_calibration.result import DISTANCES_MM, CalibrationResult
from omm_core.camera_calibration.seven import result_sigma
from omm_core.errors import OmmError
from omm_core.files.calibration_set import Touched
from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform, rotation_from_euler_xyz_rad
from omm_core.imaging.circle import circle_points
from omm_core.part_pose import Observation
from omm_runs.calibrating import calibrate_set

Array = NDArray[np.float64]

SENSOR = Sensor(name="DMK 23GP031", width_px=2592, height_px=1944, pixel_size_mm=0.0022)
# Table 1 of the paper; alpha with pi added.
TABLE_1 = np.array(
    [6.189, -8.732, 27.52, 2.997e-8, -1.937e-15, -6.188e-8, 3.408e-7,
     -2.139, 0.301, -320.2, np.pi - 0.003, -0.009, 0.03]
)  # fmt: skip
UP = np.array([0.0, 0.0, 1.0])
SIGMA_PX, SIGMA_MM, DOT_MM = 0.015, 0.001, 5.0


def main() -> None:
    """Run all four."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--sets", type=Path)
    arguments = parser.parse_args()
    _against_others()
    _repeats(10)
    _consistency(arguments.draws)
    for folder in sorted(arguments.sets.iterdir()) if arguments.sets else ():
        if (folder / "truth.json").exists():
            _against_truth(folder)


def _grid(planes: int = 10, columns: int = 9, rows: int = 7) -> Array:
    """Return places in planes across the taper's axis that fill the image, (N, 3)."""
    grid = np.stack(
        np.meshgrid(np.linspace(95, 2497, columns), np.linspace(70, 1874, rows)), axis=-1
    ).reshape(-1, 2)
    rays = SENSOR.lens(TABLE_1).rays(grid) @ rotation_from_euler_xyz_rad(*TABLE_1[10:]).T
    depths = np.linspace(75, 1110, planes)
    return np.concatenate([TABLE_1[7:10] + rays * (-d / rays[:, 2:]) for d in depths])


def _seen(places: Array, rng: np.random.Generator) -> Array:
    true = places + rng.normal(0, SIGMA_MM, places.shape)
    circles = circle_points(true, np.tile(UP, (len(true), 1)), np.full(len(true), DOT_MM))
    exact = project_with_derivatives(SENSOR, TABLE_1, circles)[0]
    return exact + rng.normal(0, SIGMA_PX, exact.shape)


def _calibrated(places: Array, pixels: Array) -> CalibrationResult:
    return calibrate_by_places(
        SENSOR,
        images=[str(i) for i in range(len(places))],
        places=places,
        pixels=pixels,
        covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (len(places), 1, 1)),
        sigma_xyz_mm=SIGMA_MM,
        normal=UP,
        dot_diameter_mm=DOT_MM,
    )


def _points(camera: Array, distance_mm: float) -> Array:
    lens = SENSOR.lens(camera)
    rays = lens.rays(lens.pixel_grid(31)) * distance_mm
    return rays @ rotation_from_euler_xyz_rad(*camera[10:]).T + camera[7:10]


def _projection_error(truth: Array, camera: Array) -> list[float]:
    errors = []
    for distance in DISTANCES_MM:
        points = _points(truth, distance)[:, None]
        wanted, got = (project_with_derivatives(SENSOR, c, points)[0] for c in (truth, camera))
        errors.append(float(np.linalg.norm(got - wanted, axis=1).max()))
    return errors


def _against_others() -> None:
    places = _grid()
    pixels = _seen(places, np.random.default_rng(1))
    _calibrated(places, pixels)  # compiles, or loads what is compiled
    print("the paper's grid, 630 dots: CPU time, largest error at 150, 300, 500 mm")
    began = time.process_time()
    camera = _calibrated(places, pixels).camera
    own = time.process_time() - began
    _print_line("omm", own, own, _projection_error(TABLE_1, camera))
    began = time.process_time()
    camera = _by_scipy(places, pixels, camera)
    _print_line("scipy", time.process_time() - began, own, _projection_error(TABLE_1, camera))
    began = time.process_time()
    errors = _by_opencv(places, pixels)
    _print_line("OpenCV", time.process_time() - began, own, errors())


def _print_line(name: str, seconds: float, own: float, errors: list[float]) -> None:
    told = "  ".join(f"{error:.4f}" for error in errors)
    print(f"  {name:<8} {seconds:7.3f} s ({seconds / own:5.2f} of omm)   {told} px")


def _by_scipy(places: Array, pixels: Array, near: Array) -> Array:
    """Adjust the same model from a start 1 % and 5 mm beside, with numeric derivatives."""
    size = np.array([1, 10, 10, 1e-8, 1e-15, 1e-7, 1e-7, 1, 1, 1, 1e-2, 1e-2, 1e-2])
    circles = circle_points(places, np.tile(UP, (len(places), 1)), np.full(len(places), DOT_MM))

    def residuals(step: Array) -> Array:
        camera = near + step * size
        return (project_with_derivatives(SENSOR, camera, circles)[0] - pixels).ravel()

    start = np.zeros(13)
    start[[0, 7, 8, 9]] = 0.06, 5.0, 5.0, 5.0
    return np.asarray(near + least_squares(residuals, start, method="lm").x * size)


def _by_opencv(places: Array, pixels: Array):  # type: ignore[no-untyped-def]
    """Calibrate with one view of a spatial object; what it projects is asked for later."""
    f = 0.95 * TABLE_1[0] / SENSOR.pixel_size_mm
    guess = np.array([[f, 0, (2592 - 1) / 2], [0, f, (1944 - 1) / 2], [0, 0, 1.0]])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS
    _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
        [places.astype(np.float32)], [pixels.astype(np.float32)], (2592, 1944), guess,
        np.zeros(5), flags=flags,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12),
    )  # fmt: skip

    def errors() -> list[float]:
        found = []
        for distance in DISTANCES_MM:
            points = _points(TABLE_1, distance)
            wanted = project_with_derivatives(SENSOR, TABLE_1, points[:, None])[0]
            got = cv2.projectPoints(points, turns[0], shifts[0], matrix, distortion)[0][:, 0]
            found.append(float(np.linalg.norm(got - wanted, axis=1).max()))
        return found

    return errors


def _repeats(count: int) -> None:
    places = _grid()
    results = [_calibrated(places, _seen(places, np.random.default_rng(s))) for s in range(count)]
    cameras = np.array([r.camera for r in results])
    told = np.sqrt(np.diag(results[0].covariance))
    print(f"{count} repeats: Table 1, mean, scatter, sigma told")
    for i, name in enumerate(PARAMETERS):
        scatter = cameras[:, i].std(ddof=1)
        print(
            f"  {name:<16} {TABLE_1[i]:>12.6g} {cameras[:, i].mean():>14.8g} {scatter:>10.3g}"
            f" {told[i]:>10.3g}"
        )
    seven = 1000 * result_sigma(SENSOR, results[0].camera, results[0].covariance)
    print(f"  allows x, y, z {seven[3]:.2f}, {seven[4]:.2f}, {seven[5]:.2f} um at 300 mm")


def _consistency(draws: int) -> None:
    places = _grid(3, 6, 5)
    by_places = [_calibrated(places, _seen(places, np.random.default_rng(s))) for s in range(draws)]
    _print_squares("cmm, 90 dots", by_places)
    _print_squares("in machine, 24 images", [_in_machine(seed) for seed in range(draws)])


def _print_squares(name: str, results: list[CalibrationResult]) -> None:
    squares = []
    for result in results:
        error = result.camera - TABLE_1
        covariance = result.covariance / max(result.sigma0, 1.0) ** 2
        squares.append(error @ np.linalg.solve(covariance, error))
    expected = np.sqrt(2 * 13 / len(squares))
    print(f"squared errors over covariance, {name}: {np.mean(squares):.2f} (13 ± {expected:.2f})")


def _in_machine(seed: int) -> CalibrationResult:
    rng = np.random.default_rng(seed)
    nominal = np.array(
        [[x, y, 20.0 * ((i + j) % 2)] for i, x in enumerate((-120, -40, 40, 120))
         for j, y in enumerate((-75, 0, 75))]
    )  # fmt: skip
    true = nominal + rng.normal(0, 0.05, nominal.shape)
    plate = RigidTransform.from_euler_xyz_rad(0.004, -0.003, 0.4, (400.0, 250.0, 190.0))
    seen = []
    poses = [(t, h, s) for h in (170, 300, 450) for t in (0, 90, 180, 270) for s in (-1, 1)]
    for number, (turn, height, side) in enumerate(poses):
        place = np.array([400.0 + 30 * side, 250.0 - 20 * side, 510.0 + height])
        told = RigidTransform.from_euler_xyz_rad(0.0, 0.0, np.radians(turn), place)
        stood = place + rng.normal(0, 0.002, 3)
        circles = circle_points(true, np.tile(UP, (12, 1)), np.full(12, 6.0))
        in_taper = (plate @ circles.reshape(-1, 3) - stood) @ told.rotation
        exact = project_with_derivatives(SENSOR, TABLE_1, in_taper.reshape(12, -1, 3))[0]
        for target in np.flatnonzero(((exact > 30) & (exact < [2560, 1910])).all(axis=1)):
            seen.append(
                Observation(
                    stamp_ns=number,
                    target_id=int(target) + 1,
                    center_px=exact[target] + rng.normal(0, 0.02, 2),
                    covariance_px2=0.02**2 * np.eye(2),
                    machine_T_spindle=told,
                )
            )
    targets = tuple(
        Target(id=i, xyz_mm=xyz, dot_diameter_mm=6.0, normal=UP, sigma_xyz_mm=np.full(3, 0.05))
        for i, xyz in enumerate(nominal, start=1)
    )
    height_mm = float((plate @ true[0])[2]) + rng.normal(0, 0.005)
    return calibrate_by_run(
        SENSOR,
        seen,
        Part(name="plate", target_family="metashape12", targets=targets),
        machine_sigma_mm=0.002,
        touched=Touched(target=1, z_mm=height_mm, sigma_mm=0.005),
    )


def _against_truth(folder: Path) -> None:
    told = json.loads((folder / "truth.json").read_text())["parameters"]
    truth = np.array([told[name] for name in PARAMETERS])
    try:
        began = time.perf_counter()
        _, result = calibrate_set(folder)
        seconds = time.perf_counter() - began
    except OmmError as error:
        print(f"{folder.name}: {error}")
        return
    error = result.camera - truth
    error[10:] = (error[10:] + np.pi) % (2 * np.pi) - np.pi
    sigma = np.sqrt(np.diag(result.covariance))
    print(f"{folder.name}: {seconds:.1f} s, {len(result.observations)} dots, error in sigma")
    for name, e, s in zip(PARAMETERS, error, sigma, strict=True):
        print(f"  {name:<16} {e:>10.3g} {e / s:>6.2f}")
    worst = "  ".join(f"{v:.4f}" for v in _projection_error(truth, result.camera))
    print(f"  projection off by at most (150, 300, 500 mm): {worst} px")


if __name__ == "__main__":
    main()
