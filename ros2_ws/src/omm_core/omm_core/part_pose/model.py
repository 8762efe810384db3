"""What the kernels of part_pose take, by name.

I images, N observations, T targets, P points of each: 1, the centre itself, or 8 of its circle.
Compiled code reads the fields as it reads local variables: a name costs nothing there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class PixelModel(NamedTuple):
    """What predicts the pixels of a pose.

    Attributes
    ----------
    lens : (10,)
        ``Lens.kernel_parameters``.
    centre_kind : int
        ``CircleCentre``.
    R_calib, d_calib : (3, 3), (3,)
        taper_T_camera.
    R_cnc, d_cnc : (I, 3, 3), (I, 3)
        machine_T_spindle of each image.
    image_of, target_of : (N,)
        Which image and target an observation is of.
    points : (T, P, 3)
        X - X_0.
    """

    lens: Array
    centre_kind: int
    R_calib: Array
    d_calib: Array
    R_cnc: Array
    d_cnc: Array
    image_of: Indices
    target_of: Indices
    points: Array


class Measured(NamedTuple):
    """Centres (N, 2), and their weights W (N, 3) as (col col, col row, row row)."""

    centres: Array
    information: Array


class State(NamedTuple):
    """A pose that is being solved for: R (3, 3), d_0 (3,), γ_s (1,)."""

    R: Array
    d0: Array
    gamma_s: Array


class Normal(NamedTuple):
    """Normal equations: N = JᵀWJ (7, 7) and g = JᵀWr (7,)."""

    N: Array
    g: Array


class Camera(NamedTuple):
    """``p_in_camera = A X_M + b`` of one image, and its derivative by γ_s: dA X_M + db."""

    A: Array
    b: Array
    dA: Array
    db: Array


class Room(NamedTuple):
    """Room for kernels to work in.

    Attributes
    ----------
    outline, by_machine, by_gamma : (P, 2), (P, 2, 3), (P, 2)
        Pixels of the points, and their derivatives by X_M and γ_s.
    weights : (P, 2, 2)
        See ``circle.centre_weights``.
    J : (2, 7)
        Derivatives of one observation.
    """

    camera: Camera
    outline: Array
    by_machine: Array
    by_gamma: Array
    weights: Array
    J: Array
