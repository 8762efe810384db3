"""Where to start from, when nothing is known: no pose of the part, no angle of the holder.

Each observation is a ray in the machine, from the camera's centre o along the unit vector v. For
a given γ_s a part pose should bring each target X onto its ray::

    e = (I - v vᵀ) (R X + d - o)

d follows from R by linear least squares; what remains is a quadratic function of the nine
elements of R alone, however many observations there are (as in the "generalised camera"
literature: Kneip, Li, Seo 2014, UPnP; Terzakis, Lourakis 2020, SQPnP). Its minima over all
rotations are found from 24 starts, those of the cube, for γ_s on a circle of angles. They are few;
the two of a plane of targets seen from afar are among them. Which one is right is decided by
the pixels afterwards (solver.py).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.start_kernels import Minima, Sights, find_minima

Array = NDArray[np.float64]

GAMMA_STEPS = 12
_ENOUGH = 256  # observations; a start needs no more


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """A pose to start from: ``X_M = rotation (X - X_0) + d0_mm``."""

    rotation: Array
    d0_mm: Array
    gamma_s_rad: float
    cost_mm2: float


def cube_rotations() -> Array:
    """Return the 24 rotations of the cube, (24, 3, 3): no rotation is farther than 63° from all."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            rotation = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.linalg.det(rotation) > 0:
                found.append(rotation)
    return np.array(found)


_CUBE = cube_rotations()


def find_starts(
    *,
    rays: Array,
    taper_R_camera: Array,
    taper_d_camera_mm: Array,
    machine_R_spindle: Array,
    machine_d_spindle_mm: Array,
    image_of: NDArray[np.int64],
    X_mm: Array,
    gammas_rad: Array,
) -> list[Start]:
    """Return poses to start from, the most promising first.

    Parameters
    ----------
    rays : (N, 3) array
        Directions in ``camera_optical`` in which the targets were seen.
    taper_R_camera, taper_d_camera_mm : (3, 3), (3,) arrays
    machine_R_spindle, machine_d_spindle_mm : (I, 3, 3), (I, 3) arrays
        Poses of the spindle, one for each image.
    image_of : (N,) array
        Image of each observation.
    X_mm : (N, 3) array
        Target of each observation, part frame, relative to X_0.
    gammas_rad : (G,) array
        Angles of the holder to try.
    """
    chosen = np.unique(np.linspace(0, len(rays) - 1, min(len(rays), _ENOUGH)).astype(np.int64))
    rays = rays[chosen] / np.linalg.norm(rays[chosen], axis=1, keepdims=True)
    # Around the spindle's mean position, and in units of the part, numbers are near 1.
    origin = machine_d_spindle_mm.mean(axis=0)
    unit = max(float(np.abs(X_mm).max()), 1.0)
    most = len(gammas_rad) * len(_CUBE)
    found = Minima(np.empty((most, 9)), np.empty((most, 3)), np.empty(most), np.empty(most))
    sights = Sights(
        rays=rays,
        R_calib=taper_R_camera,
        d_calib=taper_d_camera_mm / unit,
        R_cnc=machine_R_spindle,
        d_cnc=(machine_d_spindle_mm - origin) / unit,
        image_of=image_of[chosen],
        X=X_mm[chosen] / unit,
    )
    count = find_minima(sights, np.asarray(gammas_rad, dtype=float), _CUBE, found)
    starts = [
        Start(
            rotation=found.R[k].reshape(3, 3).copy(),
            d0_mm=found.d0[k] * unit + origin,
            gamma_s_rad=float(found.gamma_s[k]),
            cost_mm2=float(found.cost[k]) * unit**2,
        )
        for k in range(count)
    ]
    return sorted(starts, key=lambda start: start.cost_mm2)
