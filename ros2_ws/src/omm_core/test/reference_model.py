"""The measurement model in plain numpy, with the paper's own parameters: what the kernels must be.

θ = (α, β, γ, x, y, z, γ_s); one target point in one image. Each function is one equation of the
paper, in its right form; the errata are proven in test_paper_errata.py.
"""

import numpy as np

from omm_core.geometry import RigidTransform, holder_rotation, rotation_from_euler_xyz_rad


def turn(axis, angle):
    """Return the elementary rotation about an axis, and its derivative by the angle."""
    generator = np.zeros((3, 3))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    generator[j, i], generator[i, j] = 1.0, -1.0
    euler = [0.0, 0.0, 0.0]
    euler[axis] = angle
    rotation = rotation_from_euler_xyz_rad(*euler)
    return rotation, generator @ rotation


def part_rotation_derivatives(theta):
    """Eqs. 18 to 20: dR_p/dα, dR_p/dβ, dR_p/dγ."""
    (a, da), (b, db), (g, dg) = (turn(axis, theta[axis]) for axis in range(3))
    return g @ b @ da, g @ db @ a, dg @ b @ a


def camera(theta, machine_T_spindle, taper_T_camera):
    """Eq. 21: R_C, d_C."""
    R_s = holder_rotation(theta[6])
    R_C = machine_T_spindle.rotation @ R_s @ taper_T_camera.rotation
    d_C = (
        machine_T_spindle.rotation @ R_s @ taper_T_camera.translation_mm
        + machine_T_spindle.translation_mm
    )
    return R_C, d_C


def point_in_camera(theta, X, machine_T_spindle, taper_T_camera):
    """Eq. 4: U = R_Cᵀ (R_p X + d_p - d_C)."""
    R_C, d_C = camera(theta, machine_T_spindle, taper_T_camera)
    return R_C.T @ (rotation_from_euler_xyz_rad(*theta[:3]) @ X + theta[3:6] - d_C)


def point_in_camera_jacobian(theta, X, machine_T_spindle, taper_T_camera):
    """Eqs. 17 and 26 in their right form: dU/dθ, (3, 7)."""
    R_cnc, R_calib = machine_T_spindle.rotation, taper_T_camera.rotation
    d_calib = taper_T_camera.translation_mm
    R_C, d_C = camera(theta, machine_T_spindle, taper_T_camera)
    c, s = np.cos(theta[6]), np.sin(theta[6])
    D_s = np.array([[-s, c, 0.0], [-c, -s, 0.0], [0.0, 0.0, 0.0]])  # eq. 27, (3, 3) entry 0
    X_M = rotation_from_euler_xyz_rad(*theta[:3]) @ X + theta[3:6]
    jacobian = np.empty((3, 7))
    for column, derivative in enumerate(part_rotation_derivatives(theta)):
        jacobian[:, column] = R_C.T @ derivative @ X
    jacobian[:, 3:6] = R_C.T
    jacobian[:, 6] = (R_cnc @ D_s @ R_calib).T @ (X_M - d_C) - R_C.T @ (R_cnc @ D_s @ d_calib)
    return jacobian


def predict(lens, theta, X, machine_T_spindle, taper_T_camera):
    """Eq. 5 with the lens: pixel (2,) and its derivative by θ (2, 7)."""
    U = point_in_camera(theta, X, machine_T_spindle, taper_T_camera)
    pixel, by_point = lens.project_with_jacobian(U[None])
    jacobian = by_point[0] @ point_in_camera_jacobian(theta, X, machine_T_spindle, taper_T_camera)
    return pixel[0], jacobian


def pose_of(theta):
    """Return machine_T_part of θ."""
    return RigidTransform.from_euler_xyz_rad(*theta[:3], translation_mm=theta[3:6])
