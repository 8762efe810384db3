"""From target centres to the pose of the part: least squares, covariance, tests, words."""

from omm_core.estimation.problem import (
    THETA_NAMES,
    Observation,
    Problem,
    SolveOptions,
    build_problem,
)
from omm_core.estimation.solver import Solution, solve

__all__ = [
    "THETA_NAMES",
    "Observation",
    "Problem",
    "Solution",
    "SolveOptions",
    "build_problem",
    "solve",
]
