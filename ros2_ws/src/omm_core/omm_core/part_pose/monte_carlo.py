"""Many solutions of one problem with other noise: what a covariance is checked against."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from omm_core.part_pose.adjustment import MAX_ITERATIONS, TOLERANCE_SIGMA, Adjustment
from omm_core.part_pose.gauss_newton import gauss_newton
from omm_core.part_pose.model import Measured, State
from omm_core.part_pose.observation import SolveOptions
from omm_core.part_pose.problem import Problem

Array = NDArray[np.float64]


@njit(cache=True)
def _solve_each(model, many, size, iterations, tolerance, start, solutions):
    """Fill the solutions for many sets of centres (M, N, 2); return how many did not converge."""
    N = np.empty((7, 7))
    failed = 0
    for k in range(many.centres.shape[0]):
        state = State(solutions.R[k], solutions.d0[k], solutions.gamma_s[k])
        state.R[:] = start.R
        state.d0[:] = start.d0
        state.gamma_s[:] = start.gamma_s
        measured = Measured(many.centres[k], many.information)
        _, _, converged = gauss_newton(model, measured, size, iterations, tolerance, state, N)
        failed += not converged
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
    solutions = State(np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 1)))
    failed = _solve_each(
        problem.model(circles=circles),
        Measured(np.ascontiguousarray(measured), problem.information),
        options.unknowns, MAX_ITERATIONS, TOLERANCE_SIGMA,
        State(start.rotation, start.d0_mm, np.array([start.gamma_s_rad])), solutions,
    )  # fmt: skip
    return solutions.R, solutions.d0, solutions.gamma_s[:, 0], int(failed)
