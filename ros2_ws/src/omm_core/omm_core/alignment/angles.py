"""Angles of a rotation in the orders that controls use, in degrees."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import euler_xyz_rad_from_rotation, rotation_from_euler_xyz_rad

Array = NDArray[np.float64]
Angles = tuple[float, float, float]


def rpy_deg(rotation: Array) -> Angles:
    """Return (α, β, γ) about fixed x, y, z: ``R = Rz(γ) Ry(β) Rx(α)``, β within ±90°."""
    return _degrees(*euler_xyz_rad_from_rotation(rotation))


def rotation_of_rpy(angles_deg: Angles) -> Array:
    """Return ``Rz(γ) Ry(β) Rx(α)``."""
    return rotation_from_euler_xyz_rad(*np.radians(angles_deg))


def zxz_deg(rotation: Array) -> Angles:
    """Return (I, J, K): ``R = Rz(I) Rx(J) Rz(K)``, J within 0…180°; I = 0 where J decides nothing.

    J is taken from an arc tangent: an arc cosine loses half the digits of a small tilt.
    """
    tilt = math.hypot(rotation[0, 2], rotation[1, 2])
    j = math.atan2(tilt, rotation[2, 2])
    if tilt < 1e-12:
        return _degrees(0.0, j, math.atan2(-rotation[0, 1], rotation[0, 0]))
    i = math.atan2(rotation[0, 2], -rotation[1, 2])
    return _degrees(i, j, math.atan2(rotation[2, 0], rotation[2, 1]))


def rotation_of_zxz(angles_deg: Angles) -> Array:
    """Return ``Rz(I) Rx(J) Rz(K)``."""
    i, j, k = np.radians(angles_deg)
    about = rotation_from_euler_xyz_rad
    return np.asarray(about(0.0, 0.0, i) @ about(j, 0.0, 0.0) @ about(0.0, 0.0, k))


def xyz_turned_deg(rotation: Array) -> Angles:
    """Return (A, B, C) about x, turned y, twice turned z: ``R = Rx(A) Ry(B) Rz(C)``."""
    a = math.atan2(-rotation[1, 2], rotation[2, 2])
    b = math.atan2(rotation[0, 2], math.hypot(rotation[0, 0], rotation[0, 1]))
    return _degrees(a, b, math.atan2(-rotation[0, 1], rotation[0, 0]))


def rotation_of_xyz_turned(angles_deg: Angles) -> Array:
    """Return ``Rx(A) Ry(B) Rz(C)``."""
    a, b, c = np.radians(angles_deg)
    about = rotation_from_euler_xyz_rad
    return np.asarray(about(a, 0.0, 0.0) @ about(0.0, b, 0.0) @ about(0.0, 0.0, c))


def _degrees(a: float, b: float, c: float) -> Angles:
    return math.degrees(a), math.degrees(b), math.degrees(c)
