"""Rigid transforms and the rotations of the contract.

``a_T_b`` maps coordinates in frame b to coordinates in frame a, so that neighbours cancel:
``machine_T_part = machine_T_camera @ camera_T_part``. Lengths are millimetres, angles radians.
Euler angles (alpha, beta, gamma) turn about the fixed axes x, y, z in this order:
``R = Rz(gamma) Ry(beta) Rx(alpha)`` (paper eq. 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omm_core.errors import InputError

Array = NDArray[np.float64]

_ORTHONORMAL_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidTransform:
    """A rotation and a translation: ``a_T_b @ p_in_b = rotation @ p_in_b + translation_mm``.

    Attributes
    ----------
    rotation : (3, 3) array
        Orthonormal, determinant +1.
    translation_mm : (3,) array
        Origin of frame b in frame a.

    Raises
    ------
    InputError
        Where shapes or values do not make a rigid transform.
    """

    rotation: Array
    translation_mm: Array

    def __post_init__(self) -> None:
        rotation = _frozen_array(self.rotation, (3, 3), "rotation")
        error = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
        if not (error < _ORTHONORMAL_TOLERANCE and np.linalg.det(rotation) > 0.0):
            raise InputError(
                f"Expected a rotation matrix (orthonormal, determinant +1), got\n{rotation}."
            )
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(
            self, "translation_mm", _frozen_array(self.translation_mm, (3,), "translation_mm")
        )

    @classmethod
    def identity(cls) -> RigidTransform:
        """Return the transform that changes nothing."""
        return cls(rotation=np.eye(3), translation_mm=np.zeros(3))

    @classmethod
    def from_euler_xyz_rad(
        cls, alpha: float, beta: float, gamma: float, translation_mm: ArrayLike = (0.0, 0.0, 0.0)
    ) -> RigidTransform:
        """Return the transform with ``R = Rz(gamma) Ry(beta) Rx(alpha)`` (paper eq. 2)."""
        return cls(
            rotation=rotation_from_euler_xyz_rad(alpha, beta, gamma),
            translation_mm=np.asarray(translation_mm, dtype=float),
        )

    @classmethod
    def from_quaternion_xyzw(
        cls, quaternion_xyzw: ArrayLike, translation_mm: ArrayLike = (0.0, 0.0, 0.0)
    ) -> RigidTransform:
        """Return the transform of a quaternion (x, y, z, w) of any length above zero."""
        return cls(
            rotation=rotation_from_quaternion_xyzw(quaternion_xyzw),
            translation_mm=np.asarray(translation_mm, dtype=float),
        )

    def euler_xyz_rad(self) -> tuple[float, float, float]:
        """Return (alpha, beta, gamma), see :func:`euler_xyz_rad_from_rotation`."""
        return euler_xyz_rad_from_rotation(self.rotation)

    def quaternion_xyzw(self) -> Array:
        """Return the unit quaternion (x, y, z, w) with w >= 0."""
        return quaternion_xyzw_from_rotation(self.rotation)

    def inverse(self) -> RigidTransform:
        """Return ``b_T_a``."""
        return RigidTransform(
            rotation=self.rotation.T, translation_mm=-self.rotation.T @ self.translation_mm
        )

    def __matmul__(self, other: Any) -> Any:
        """Compose with a transform, or map points of shape (..., 3)."""
        if isinstance(other, RigidTransform):
            return RigidTransform(
                rotation=self.rotation @ other.rotation,
                translation_mm=self.rotation @ other.translation_mm + self.translation_mm,
            )
        points = np.asarray(other, dtype=float)
        if points.shape[-1:] != (3,):
            raise InputError(f"Expected points of shape (..., 3), got {points.shape}.")
        return points @ self.rotation.T + self.translation_mm


def rotation_from_euler_xyz_rad(alpha: float, beta: float, gamma: float) -> Array:
    """Return ``Rz(gamma) Ry(beta) Rx(alpha)``, shape (3, 3) (paper eq. 2)."""
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    cg, sg = np.cos(gamma), np.sin(gamma)
    return np.array(
        [
            [cg * cb, cg * sb * sa - sg * ca, cg * sb * ca + sg * sa],
            [sg * cb, sg * sb * sa + cg * ca, sg * sb * ca - cg * sa],
            [-sb, cb * sa, cb * ca],
        ]
    )


def euler_xyz_rad_from_rotation(rotation: ArrayLike) -> tuple[float, float, float]:
    """Return (alpha, beta, gamma) with beta in [-pi/2, pi/2]; at beta = +-pi/2 alpha is 0."""
    r = np.asarray(rotation, dtype=float)
    cos_beta = float(np.hypot(r[0, 0], r[1, 0]))
    beta = float(np.arctan2(-r[2, 0], cos_beta))
    if cos_beta < 1e-12:
        return 0.0, beta, float(np.arctan2(-r[0, 1], r[1, 1]))
    return float(np.arctan2(r[2, 1], r[2, 2])), beta, float(np.arctan2(r[1, 0], r[0, 0]))


def holder_rotation(gamma_s_rad: float) -> Array:
    """Return ``R_s(gamma_s)`` of ``spindle_T_taper`` (paper eq. 22; this is ``Rz(-gamma_s)``)."""
    c, s = np.cos(gamma_s_rad), np.sin(gamma_s_rad)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def spindle_T_taper(gamma_s_rad: float) -> RigidTransform:
    """Return how the holder sits in the spindle: turned by gamma_s, not shifted."""
    return RigidTransform(rotation=holder_rotation(gamma_s_rad), translation_mm=np.zeros(3))


def rotation_from_quaternion_xyzw(quaternion_xyzw: ArrayLike) -> Array:
    """Return the rotation matrix of a quaternion (x, y, z, w) of any length above zero."""
    q = np.asarray(quaternion_xyzw, dtype=float)
    length = float(np.linalg.norm(q)) if q.shape == (4,) else 0.0
    if not (np.isfinite(length) and length > 1e-9):
        raise InputError(f"Expected a quaternion (x, y, z, w) of length 1, got {q}.")
    x, y, z, w = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_xyzw_from_rotation(rotation: ArrayLike) -> Array:
    """Return the unit quaternion (x, y, z, w), w >= 0, by the largest of the four components."""
    r = np.asarray(rotation, dtype=float)
    xyzw_squared_times_4 = 1.0 + np.array(
        [
            r[0, 0] - r[1, 1] - r[2, 2],
            r[1, 1] - r[0, 0] - r[2, 2],
            r[2, 2] - r[0, 0] - r[1, 1],
            r[0, 0] + r[1, 1] + r[2, 2],
        ]
    )
    # 4 q qᵀ, of which each row is the quaternion times four times one of its components.
    xy, xz, yz = r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
    xw, yw, zw = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    outer = np.array([[0, xy, xz, xw], [xy, 0, yz, yw], [xz, yz, 0, zw], [xw, yw, zw, 0]])
    row = (outer + np.diag(xyzw_squared_times_4))[int(np.argmax(xyzw_squared_times_4))]
    q = row / np.linalg.norm(row)
    return np.asarray(-q if q[3] < 0.0 else q)


def _frozen_array(values: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    array = np.array(values, dtype=float)
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise InputError(f"Expected {name} as {shape} finite numbers, got {array.tolist()}.")
    array.flags.writeable = False
    return array
