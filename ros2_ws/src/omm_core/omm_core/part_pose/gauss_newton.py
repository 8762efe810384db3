"""Gauss-Newton from a start (eqs. 9 to 13 of the paper), compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from omm_core.imaging.kernels import FASTMATH
from omm_core.numerics.linear_algebra import copy_to, solve_damped
from omm_core.part_pose.kernels import normal_equations, rotate, workspace
from omm_core.part_pose.model import Normal, State

_compiled = njit(cache=True, error_model="numpy", fastmath=FASTMATH)

_STILL = 8  # steps of 1e-2 standard deviations in all, after which no more are made


@_compiled
def gauss_newton(model, measured, size, iterations, tolerance, state, N):
    """Minimise rᵀWr from a start, damped where a step does not lower it.

    Parameters
    ----------
    model, measured : PixelModel, Measured
    size : int
        7, or 6 with γ_s given.
    tolerance : float
        A step shorter than this many standard deviations is the last one. Steps shrink by 1000
        or more each time (test_circle_centre.py), so that what is left is as much smaller.
    state : State
        The start, replaced by the solution.
    N : (7, 7) array
        Filled with the normal matrix at the solution.

    Returns
    -------
    cost : float
        rᵀWr; infinite where the start does not see all targets.
    iterations : int
    converged : bool
    """
    room = workspace(model.points.shape[1])
    here, there = Normal(N, np.empty(7)), Normal(np.empty((7, 7)), np.empty(7))
    trial = State(np.empty((3, 3)), np.empty(3), np.empty(1))
    step, L = np.zeros(7), np.empty((7, 7))
    cost = normal_equations(model, measured, state, room, here)
    if not cost < np.inf:
        return cost, 1, False
    damping, still = 0.0, 0
    for iteration in range(1, iterations + 1):
        if not solve_damped(N, here.g, size, damping, L, step):
            if damping > 1e12:
                return cost, iteration, False
            damping = max(10.0 * damping, 1e-6)
            continue
        length2 = _squared_length(N, step, size)
        _set_trial(state, step, size, trial)
        cost_new = normal_equations(model, measured, trial, room, there)
        # The cost falls by the square of the step: for a short one by less than its last digits
        # hold, or by less than the derivatives of a large circle's image are off (1e-5 of them),
        # so that it may seem to rise.
        short = length2 < 1e-4 + 1e-10 * cost
        if cost_new <= cost or (short and cost_new < np.inf):
            cost = cost_new
            _accept(trial, there, state, here)
            # Where the model bends within its last digits, steps may end to and fro.
            still += short and damping < 1e-3
            last = length2 < tolerance * tolerance
            if (last and damping < 1e-3) or still > _STILL:
                return cost, iteration, True
            damping = damping * 0.1 if damping > 1e-9 else 0.0
        else:
            damping = max(10.0 * damping, 1e-4)
    return cost, iterations, False


@_compiled
def _squared_length(N, step, size):
    """Return stepᵀ N step: the square of the step in standard deviations."""
    length2 = 0.0
    for i in range(size):
        for j in range(size):
            length2 += step[i] * N[i, j] * step[j]
    return length2


@_compiled
def _set_trial(state, step, size, trial):
    """Fill the state after a step."""
    rotate(state.R, step[0], step[1], step[2], trial.R)
    for i in range(3):
        trial.d0[i] = state.d0[i] + step[3 + i]
    trial.gamma_s[0] = state.gamma_s[0] + (step[6] if size == 7 else 0.0)


@_compiled
def _accept(trial, there, state, here):
    """Make the trial the state, and its equations those of the state."""
    copy_to(state.R, trial.R)
    copy_to(here.N, there.N)
    for i in range(3):
        state.d0[i] = trial.d0[i]
    for i in range(7):
        here.g[i] = there.g[i]
    state.gamma_s[0] = trial.gamma_s[0]
