"""Errors of a machine that is not exact, as they are drawn for simulation; no estimator uses them.

docs/simulated_machine.md says what each of them is and how large it is in real machines.
"""

from omm_core.machine_errors.drawing import (
    GeometryField,
    draw_calibration,
    draw_geometry,
    draw_stop_noise,
    draw_targets,
    geometry_covariance,
)
from omm_core.machine_errors.motion import (
    approach_signs,
    lost_motion,
    spindle_drift,
    thermally_expanded,
)
from omm_core.machine_errors.own_truth import geometry_fit, own_pose

__all__ = [
    "GeometryField",
    "approach_signs",
    "draw_calibration",
    "draw_geometry",
    "draw_stop_noise",
    "draw_targets",
    "geometry_covariance",
    "geometry_fit",
    "lost_motion",
    "own_pose",
    "spindle_drift",
    "thermally_expanded",
]
