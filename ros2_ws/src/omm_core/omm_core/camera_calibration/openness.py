"""What a set leaves open of a camera: the null space of its normal equations, told by names.

The information (13, 13) that a set has of the camera, with everything else eliminated, is measured
in *sizes*: changes of each parameter that move an image point by some 25 px. A direction of which
the set knows less than that (eigenvalue below 1) is open, whether the algebra leaves it open
exactly or the noise does. Directions are told in echelon form: each by one parameter that no other
direction has, and by those that go with it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from omm_core.adjustment import Problem
from omm_core.adjustment.normal_equations import linearise
from omm_core.adjustment.problem import Values
from omm_core.camera_calibration.model import PARAMETERS, Sensor
from omm_core.errors import MeasurementError

Array = NDArray[np.float64]

_MOVES_PX = 25.0
_PLACE_MM = 2.0
# A parameter goes with a direction if it moves by this part of what the leading one moves by.
_PARTNER = 0.1
# Lengths of the camera's place are the first to lead: they are what can be touched or assumed.
_FIRST = np.array([1.0] * 7 + [3.0] * 3 + [1.0] * 3)


def sizes(sensor: Sensor, focal_length_mm: float) -> Array:
    """Return changes of the 13 parameters that each move an image point by some 25 px, (13,)."""
    corner = float(np.hypot(sensor.width_px, sensor.height_px)) / 2
    f_px = focal_length_mm / sensor.pixel_size_mm
    of_lens = [
        focal_length_mm / corner, 1.0, 1.0, corner**-3, corner**-5,
        corner**-2 / 2, corner**-2 / 2,
    ]  # fmt: skip
    angle = 1.0 / f_px
    roll = 1.0 / corner
    return np.array(
        [*(_MOVES_PX * np.array(of_lens)), *[_PLACE_MM] * 3,
         *(_MOVES_PX * np.array([angle, angle, roll]))]
    )  # fmt: skip


def camera_information(problem: Problem, values: Values) -> Array:
    """Return what a problem's observations tell of its camera, all else eliminated, (13, 13)."""
    at = linearise(problem, values)
    camera = problem.slices()["camera"]
    rest = np.ones(len(at.normal), dtype=bool)
    rest[camera] = False
    own = at.normal[camera, camera]
    if not rest.any():
        return np.asarray(own)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(at.normal)[rest], 1e-300))
    others = at.normal[np.ix_(rest, rest)] * np.outer(scale, scale)
    across = at.normal[camera][:, rest] * scale
    solved = np.linalg.solve(others + 1e-13 * np.eye(len(others)), across.T)
    return np.asarray(own - across @ solved)


def open_directions(information: Array, size: Array) -> list[tuple[str, ...]]:
    """Return the directions that are open, each as the names of what moves together.

    Parameters
    ----------
    information : (13, 13) array
        Inverse covariance of the camera, singular where it is open.
    size : (13,) array
        See :func:`sizes`.

    Raises
    ------
    MeasurementError
        Where the observations cannot be predicted.
    """
    scaled = information * np.outer(size, size)
    if not np.isfinite(scaled).all():
        raise MeasurementError(
            "No camera fits the set. Check which image belongs to which place, the axes of the"
            " places (taper frame) and the size of the sensor."
        )
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    null = vectors[:, values < 1.0]
    count = null.shape[1]
    if count == 0:
        return []
    leading = qr((null * _FIRST[:, None]).T, pivoting=True, mode="r")[1][:count]
    echelon = null @ np.linalg.inv(null[leading])
    order = np.argsort(leading)
    return [
        (
            PARAMETERS[leading[j]],
            *(
                PARAMETERS[i]
                for i in np.argsort(-np.abs(echelon[:, j]))
                if i not in leading and abs(echelon[i, j]) > _PARTNER
            ),
        )
        for j in order
    ]


def words_for(directions: list[tuple[str, ...]]) -> str:
    """Return "3 directions of the camera open: a (with b, c); d; e"."""
    told = [
        names[0] + (f" (with {', '.join(names[1:5])})" if len(names) > 1 else "")
        for names in directions
    ]
    many = "1 direction" if len(told) == 1 else f"{len(told)} directions"
    return f"{many} of the camera's 13 parameters open: {'; '.join(told)}"
