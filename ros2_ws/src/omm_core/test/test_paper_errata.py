"""The paper's printed derivatives against numeric ones: where they err, and what is right."""

import numpy as np
import pytest
from core_cells import PAPER_CALIBRATION
from reference_model import (
    camera,
    part_rotation_derivatives,
    point_in_camera,
    point_in_camera_jacobian,
)

from omm_core.geometry import RigidTransform, holder_rotation, rotation_from_euler_xyz_rad

THETA = np.array([0.11, -0.23, 0.31, 40.0, -25.0, 13.0, 0.17])
X = np.array([120.0, -75.0, 31.0])
SPINDLE = RigidTransform.from_euler_xyz_rad(0.2, 0.1, -0.4, (55.0, 12.0, 700.0))
TAPER = PAPER_CALIBRATION.taper_T_camera
R_CNC, R_CALIB, D_CALIB = SPINDLE.rotation, TAPER.rotation, TAPER.translation_mm


def numeric(function, at, step=1e-6):
    """Return the derivative of a vector function by each element of its argument."""
    columns = [(function(at + h) - function(at - h)) / (2 * step) for h in step * np.eye(len(at))]
    return np.stack(columns, axis=-1)


def true_jacobian():
    return numeric(lambda theta: point_in_camera(theta, X, SPINDLE, TAPER), THETA)


def test_the_corrected_jacobian_is_the_derivative_of_equation_4():
    analytic = point_in_camera_jacobian(THETA, X, SPINDLE, TAPER)
    assert np.allclose(analytic, true_jacobian(), atol=1e-6)


def test_equations_18_to_20_are_right():
    of_rotation = numeric(lambda angles: rotation_from_euler_xyz_rad(*angles).ravel(), THETA[:3])
    for column, derivative in enumerate(part_rotation_derivatives(THETA)):
        assert np.allclose(derivative.ravel(), of_rotation[:, column], atol=1e-9)


def test_equation_16_has_the_rows_of_the_pinholes_derivative():
    u, v, w, f = 30.0, -20.0, 300.0, 6.189
    right = f * np.array([[1 / w, 0, -u / w**2], [0, 1 / w, -v / w**2]])
    of_pinhole = numeric(lambda p: f * p[:2] / p[2], np.array([u, v, w]), step=1e-4)
    assert np.allclose(right, of_pinhole, atol=1e-9)
    # As printed: [1, 0, -u/w²], [1/w, 0, -v/w²], [0, 1/w, -v/w²].
    printed = f * np.array([[1, 0, -u / w**2], [1 / w, 0, -v / w**2]])
    assert not np.allclose(printed, of_pinhole, atol=1e-3)


@pytest.mark.parametrize(
    ("translation_block", "is_right"),
    [(np.eye(3), False), (None, True)],
    ids=["as printed: I", "right: R_Cᵀ"],
)
def test_equation_17s_translation_block_is_the_transposed_camera_rotation(
    translation_block, is_right
):
    """Printed R_Cᵀ [D_A X, D_B X, D_C X, I]: read as a block beside, I would stand alone."""
    R_C, _ = camera(THETA, SPINDLE, TAPER)
    block = R_C.T if translation_block is None else translation_block
    assert np.allclose(block, true_jacobian()[:, 3:6], atol=1e-6) == is_right


def gamma_s_column(point, corner):
    """Eq. 26 with a choice of its point and of eq. 27's (3, 3) entry."""
    c, s = np.cos(THETA[6]), np.sin(THETA[6])
    D_s = np.array([[-s, c, 0.0], [-c, -s, 0.0], [0.0, 0.0, corner]])
    R_C, d_C = camera(THETA, SPINDLE, TAPER)
    return (R_CNC @ D_s @ R_CALIB).T @ (point - d_C) - R_C.T @ (R_CNC @ D_s @ D_CALIB)


def test_equation_26_takes_the_point_in_the_machine_and_equation_27_ends_in_0():
    X_M = rotation_from_euler_xyz_rad(*THETA[:3]) @ X + THETA[3:6]
    right = true_jacobian()[:, 6]
    column = gamma_s_column(X_M, corner=0.0)
    assert column.shape == (3,)  # printed as 3 x 7: it is the new column only
    assert np.allclose(column, right, atol=1e-6)
    assert not np.allclose(gamma_s_column(X, corner=0.0), right, atol=1e-3)  # X_i as printed
    assert not np.allclose(gamma_s_column(X_M, corner=1.0), right, atol=1e-3)  # 1 as printed


def test_equation_27_is_the_derivative_of_equation_22():
    c, s = np.cos(THETA[6]), np.sin(THETA[6])
    of_R_s = numeric(lambda g: holder_rotation(g[0]).ravel(), THETA[6:])[:, 0].reshape(3, 3)
    assert np.allclose(of_R_s, [[-s, c, 0], [-c, -s, 0], [0, 0, 0]], atol=1e-9)
