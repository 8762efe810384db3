"""From target centres to the pose of the part: least squares, covariance, tests, words."""

from omm_core.part_pose.observation import Observation, SolveOptions
from omm_core.part_pose.problem import THETA_NAMES, Problem, build_problem
from omm_core.part_pose.solution import Solution
from omm_core.part_pose.solver import solve

__all__ = [
    "THETA_NAMES",
    "Observation",
    "Problem",
    "Solution",
    "SolveOptions",
    "build_problem",
    "solve",
]
