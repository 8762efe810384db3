"""From target centres to the pose of the part: least squares, covariance, tests, words."""

from omm_core.part_pose.problem import (
    THETA_NAMES,
    Observation,
    Problem,
    SolveOptions,
    build_problem,
)
from omm_core.part_pose.solver import Solution, solve

__all__ = [
    "THETA_NAMES",
    "Observation",
    "Problem",
    "Solution",
    "SolveOptions",
    "build_problem",
    "solve",
]
