"""Many solutions of one problem with other noise: what a covariance is checked against."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from omm_core.part_pose.adjustment import MAX_ITERATIONS, TOLERANCE_SIGMA, Adjustment
from omm_core.part_pose.kernels import gauss_newton
from omm_core.part_pose.problem import Problem, SolveOptions

Array = NDArray[np.float64]


@njit(cache=True)
def _solve_each(lens, kind, R_calib, d_calib, R_cnc, d_cnc, image_of, target_of, points,
                measured, information, size, iterations, tolerance, R0, d0, gamma0,
                rotations, translations, gammas):  # fmt: skip
    N = np.empty((7, 7))
    failed = 0
    for k in range(measured.shape[0]):
        rotations[k] = R0
        translations[k] = d0
        gammas[k, 0] = gamma0
        _, used = gauss_newton(
            lens, kind, R_calib, d_calib, R_cnc, d_cnc, image_of, target_of, points, measured[k],
            information, size, iterations, tolerance, rotations[k], translations[k], gammas[k], N,
        )  # fmt: skip
        failed += used <= 0
    return failed


def solve_each(
    problem: Problem,
    options: SolveOptions,
    measured: Array,
    start: Adjustment,
    *,
    circles: bool = True,
) -> tuple[Array, Array, Array, int]:
    """Solve the same problem for many sets of measured centres.

    Parameters
    ----------
    measured : (M, N, 2) array
        Centres in the order of the problem's observations, px.
    start : Adjustment
        Where each solution starts.
    circles : bool
        Whether targets are circles, or points as in the paper.

    Returns
    -------
    rotations, translations_mm, gammas_rad : (M, 3, 3), (M, 3), (M,) arrays
        ``X_M = rotation (X - X_0) + translation``.
    failed : int
        How many did not converge.
    """
    count = len(measured)
    rotations, translations = np.empty((count, 3, 3)), np.empty((count, 3))
    gammas = np.empty((count, 1))
    failed = _solve_each(
        *problem.model_arguments(circles=circles), np.ascontiguousarray(measured),
        problem.information, options.unknowns, MAX_ITERATIONS, TOLERANCE_SIGMA,
        start.rotation, start.d0_mm, start.gamma_s_rad, rotations, translations, gammas,
    )  # fmt: skip
    return rotations, translations, gammas[:, 0], int(failed)
