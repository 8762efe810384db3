"""What a set in the machine leaves open of the camera's place, and what is assumed of it.

Each open length is held at a value with a sigma: of a coarse touch (z), of the hint, or of the
spindle's axis and nose. What else moves with it is carried into the covariance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from omm_core.camera_calibration.machine_run import PlateRun, plate_problem
from omm_core.camera_calibration.model import PARAMETERS
from omm_core.camera_calibration.openness import (
    camera_information,
    open_directions,
    sizes,
    words_for,
)
from omm_core.errors import MeasurementError
from omm_core.files.calibration_set import Touched
from omm_core.geometry import rotation_from_euler_xyz_rad

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# What is assumed of a camera's place that a set leaves open: within this of the hint, or of the
# spindle's axis (x, y) and nose (z).
ASSUMED_SIGMA_MM = {"x_mm": 10.0, "y_mm": 10.0, "z_mm": 500.0}
_HINTED_SIGMA_MM = 10.0
# A touch with more than this is no observation to adjust with: z is held where it puts it.
_COARSE_TOUCH_MM = 0.5
# A touch gives a height (machine Z); it is one along the spindle's axis where that is this upright.
_UPRIGHT = 0.5
PLACE = slice(7, 10)


def coarse_touch(run: PlateRun) -> Touched | None:
    """Return the touch where it is too coarse to adjust with, but tells z_mm."""
    touched = run.touched
    if touched is None or touched.sigma_mm <= _COARSE_TOUCH_MM or abs(_upright(run)) < _UPRIGHT:
        return None
    return touched


def without_coarse_touch(run: PlateRun) -> PlateRun:
    """Return the run without its touch, where that is a coarse one."""
    return run if coarse_touch(run) is None else replace(run, touched=None)


def _upright(run: PlateRun) -> float:
    """Return the height that a length along the spindle's axis makes."""
    return float(run.rotations[0][2, 2])


def opened_by(
    run: PlateRun, used: Mask, values: dict[str, Array]
) -> tuple[Array, list[tuple[str, ...]]]:
    """Return what the set tells of the camera (13, 13), and the directions that it leaves open."""
    problem = plate_problem(run, used, values)
    start = {group.name: group.values for group in problem.groups}
    information = camera_information(problem, start)
    size = sizes(run.sensor, float(values["camera"][0, 0]))
    return information, open_directions(information, size)


def assumed_sigmas(
    opened: list[tuple[str, ...]], run: PlateRun, *, hinted: bool
) -> dict[str, float]:
    """Return the lengths to assume with their sigma; raise where more than the place is open."""
    names = {name for direction in opened for name in direction}
    if names - set(ASSUMED_SIGMA_MM):
        raise MeasurementError(
            f"The set leaves {words_for(opened)}. Take images of the whole plate at several heights"
            " and places, and with the spindle turned."
        )
    sigmas = {
        name: _HINTED_SIGMA_MM if hinted else sigma
        for name, sigma in ASSUMED_SIGMA_MM.items()
        if name in names
    }
    touched = coarse_touch(run)
    if "z_mm" in sigmas and touched is not None:
        sigmas["z_mm"] = touched.sigma_mm / abs(_upright(run))
    return sigmas


def placed(
    run: PlateRun, values: dict[str, Array], names: tuple[str, ...], hint: Array | None
) -> dict[str, Array]:
    """Return the values with what is assumed set, and the plate moved along with it."""
    camera, plate = values["camera"].copy(), values["plate"].copy()
    touched = coarse_touch(run)
    for name in names:
        at = PARAMETERS.index(name)
        axis = run.rotations[0][:, at - PLACE.start]
        step = (0.0 if hint is None else hint[at]) - camera[0, at]
        if name == "z_mm" and touched is not None:
            step = _below_touch(run, touched, plate[0]) / _upright(run)
        plate[0, 3:] += axis * step
        camera[0, at] += step
    return {"camera": camera, "plate": plate}


def _below_touch(run: PlateRun, touched: Touched, plate: Array) -> float:
    """Return by how much the touched target lies too low, mm."""
    xyz = run.xyz[run.target_ids.index(touched.target)]
    height = rotation_from_euler_xyz_rad(*plate[:3])[2] @ xyz + plate[5]
    return float(touched.z_mm - height)


def carried_along(information: Array, names: tuple[str, ...]) -> Array:
    """Return how the camera moves with what is assumed, (13, A): rows of ``names`` are unit."""
    at = [PARAMETERS.index(name) for name in names]
    rest = [i for i in range(len(PARAMETERS)) if i not in at]
    carried = np.zeros((len(PARAMETERS), len(at)))
    carried[at] = np.eye(len(at))
    scale = 1.0 / np.sqrt(np.diag(information)[rest])
    known = information[np.ix_(rest, rest)] * np.outer(scale, scale)
    moved = np.linalg.solve(known, information[np.ix_(rest, at)] * scale[:, None])
    carried[rest] = -moved * scale[:, None]
    return carried
