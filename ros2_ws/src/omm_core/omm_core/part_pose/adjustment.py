"""Least squares of one problem: from a start, and from nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import euler_xyz_rad_from_rotation
from omm_core.part_pose.gauss_newton import gauss_newton
from omm_core.part_pose.kernels import predict_all, rotate
from omm_core.part_pose.model import State
from omm_core.part_pose.observation import SolveOptions
from omm_core.part_pose.problem import Problem
from omm_core.part_pose.start import GAMMA_STEPS, Start, find_starts

Array = NDArray[np.float64]

MAX_ITERATIONS = 60
TOLERANCE_SIGMA = 1e-5
_VALLEY_SIGMA = 1.0  # to what the point model is solved before the circles come in
_SCREENED = 12  # starts that are refined by the pixels
_SAME_VALLEY_RAD = 1e-4
_SAME_POSE_RAD = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Adjustment:
    """A pose that fits the observations best, in the unknowns of kernels.py.

    Attributes
    ----------
    rotation, d0_mm, gamma_s_rad
        ``X_M = rotation (X - X_0) + d0_mm``.
    cost : float
        Weighted sum of squared residuals.
    normal : (7, 7) array
        JᵀWJ in the order (ω, d_0, γ_s).
    converged : bool
    iterations : int
    """

    rotation: Array
    d0_mm: Array
    gamma_s_rad: float
    cost: float
    normal: Array
    converged: bool
    iterations: int

    def theta(self, X0_mm: Array) -> Array:
        """Return (α, β, γ, x, y, z, γ_s), rad and mm; γ_s in (-π, π]."""
        d_p = self.d0_mm - self.rotation @ X0_mm
        gamma_s = float(np.pi - np.mod(np.pi - self.gamma_s_rad, 2 * np.pi))
        return np.array([*euler_xyz_rad_from_rotation(self.rotation), *d_p, gamma_s])

    def d_theta_d_local(self, X0_mm: Array) -> Array:
        """Return d(θ)/d(ω, d_0, γ_s), (7, 7).

        ``ω = E (dα, dβ, dγ)`` with the axes of the three turns as columns of E; at β = ±90° two of
        them are one, and α and γ have no covariance of their own (they come out huge).
        """
        _, beta, gamma = euler_xyz_rad_from_rotation(self.rotation)
        cos_beta = np.copysign(max(abs(np.cos(beta)), 1e-9), np.cos(beta))
        c, s = np.cos(gamma), np.sin(gamma)
        x, y, z = self.rotation @ X0_mm
        result = np.eye(7)
        result[:3, :3] = [
            [c / cos_beta, s / cos_beta, 0.0],
            [-s, c, 0.0],
            [c * np.sin(beta) / cos_beta, s * np.sin(beta) / cos_beta, 1.0],
        ]
        # d_p = d_0 - R_p X_0, so that δd_p = δd_0 - ω x (R_p X_0) = δd_0 + [R_p X_0]x ω.
        result[3:6, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
        return result


def refine(
    problem: Problem, options: SolveOptions, start: Start | Adjustment, *, circles: bool = True
) -> Adjustment:
    """Return the optimum next to a start, with circles or with points for targets.

    The point model is eight times cheaper and, from afar, finds the same valley: where circles are
    wanted, it goes first.
    """
    state = State(
        R=np.ascontiguousarray(start.rotation).copy(),
        d0=np.ascontiguousarray(start.d0_mm).copy(),
        gamma_s=np.array([start.gamma_s_rad]),
    )
    N, seen, size = np.zeros((7, 7)), problem.seen, options.unknowns
    points = problem.model(circles=False)
    cost, iterations, converged = gauss_newton(
        points, seen, size, MAX_ITERATIONS, _VALLEY_SIGMA, state, N
    )
    if circles:
        model = problem.model()
        cost, iterations, converged = gauss_newton(
            model, seen, size, MAX_ITERATIONS, TOLERANCE_SIGMA, state, N
        )
    return Adjustment(
        rotation=state.R, d0_mm=state.d0, gamma_s_rad=float(state.gamma_s[0]), normal=N,
        cost=float(cost), converged=bool(converged), iterations=int(iterations),
    )  # fmt: skip


def adjust(problem: Problem, options: SolveOptions) -> list[Adjustment]:
    """Return all minima that were found from nothing, the best first.

    More than one means that the observations allow several poses; the next best one's cost tells
    how much less likely it is. Empty where no pose was found that the camera could have seen.
    """
    circle = np.linspace(0.0, 2 * np.pi, GAMMA_STEPS, endpoint=False)
    starts = find_starts(
        rays=problem.calibration.lens.rays(problem.measured),
        taper_R_camera=problem.R_calib,
        taper_d_camera_mm=problem.d_calib,
        machine_R_spindle=problem.R_cnc,
        machine_d_spindle_mm=problem.d_cnc,
        image_of=problem.image_of,
        X_mm=problem.points[problem.target_of, 0],
        gammas_rad=np.array([options.gamma_s_rad]) if options.model == "6d" else circle,
    )
    valleys: list[Adjustment] = []
    refined = 0
    for start in starts:
        found = refine(problem, options, start, circles=False)
        if not np.isfinite(found.cost):
            continue
        refined += 1
        if not any(_same(found, other, _SAME_VALLEY_RAD) for other in valleys):
            valleys.append(found)
        if refined >= _SCREENED:
            break
    lowest = min((_rms_px(problem, found) for found in valleys), default=0.0)
    minima: list[Adjustment] = []
    for valley in valleys:
        # Points for circles are wrong by less than a pixel.
        if _rms_px(problem, valley) > 2.0 * lowest + 1.0:
            continue
        found = refine(problem, options, valley)
        if np.isfinite(found.cost) and not any(
            _same(found, other, _SAME_POSE_RAD) for other in minima
        ):
            minima.append(found)
    return sorted(minima, key=lambda found: found.cost)


def _rms_px(problem: Problem, adjustment: Adjustment) -> float:
    information = float(problem.information[:, [0, 2]].sum())
    return float(np.sqrt(adjustment.cost / information))


def moved(adjustment: Adjustment, step: Array) -> Adjustment:
    """Return the pose after a step (ω, d_0, γ_s), (6,) or (7,)."""
    rotation = np.empty((3, 3))
    rotate(adjustment.rotation, step[0], step[1], step[2], rotation)
    gamma_s = adjustment.gamma_s_rad + (float(step[6]) if len(step) == 7 else 0.0)
    return replace(
        adjustment, rotation=rotation, d0_mm=adjustment.d0_mm + step[3:6], gamma_s_rad=gamma_s
    )


def predictions(problem: Problem, adjustment: Adjustment) -> tuple[Array, Array]:
    """Return predicted pixels (N, 2) and their derivatives by (ω, d_0, γ_s), (N, 2, 7)."""
    pixels, jacobians = np.empty((len(problem), 2)), np.empty((len(problem), 2, 7))
    predict_all(
        problem.model(), adjustment.rotation, adjustment.d0_mm,
        adjustment.gamma_s_rad, pixels, jacobians,
    )  # fmt: skip
    return pixels, jacobians


def whitening_of(problem: Problem) -> Array:
    """Return Cᵀ of each observation's weights ``W = C Cᵀ``, (N, 2, 2)."""
    information = problem.information
    a = np.sqrt(information[:, 0])
    b = information[:, 1] / a
    c = np.sqrt(information[:, 2] - b * b)
    zero = np.zeros_like(a)
    return np.stack([np.stack([a, b], axis=1), np.stack([zero, c], axis=1)], axis=1)


def by_calibration(
    problem: Problem, adjustment: Adjustment, names: tuple[str, ...], steps: Iterable[Array]
) -> Iterator[Array]:
    """Yield by how much each step (P,) of the calibration's parameters moves the pixels, (N, 2).

    By central differences: half of what it is from one step back to one step on.
    """
    calibration = problem.calibration
    values = calibration.parameter_values(names)
    for step in steps:
        up, down = (
            predictions(
                problem.with_calibration(calibration.with_parameters(names, values + sign * step)),
                adjustment,
            )[0]
            for sign in (1.0, -1.0)
        )
        yield (up - down) / 2.0


def _same(one: Adjustment, other: Adjustment, tolerance_rad: float) -> bool:
    turned = np.abs(one.rotation - other.rotation).max() > tolerance_rad
    holder = abs(np.sin((one.gamma_s_rad - other.gamma_s_rad) / 2)) > tolerance_rad
    return not (turned or holder)
