"""What ``./omm calibrate --plan`` prints."""

import numpy as np

from omm_core.camera_calibration.model import PARAMETERS
from omm_core.camera_calibration.result import DISTANCES_MM
from omm_core.planning.calibration_plan import SIGMA_PX, CalibrationPlan, CalibrationScene
from omm_core.planning.program import Program


def calibration_plan_lines(
    scene: CalibrationScene, plan: CalibrationPlan, want_px: float
) -> list[str]:
    """Return the lines that people read: what is reached, the stops, what to touch."""
    verdict = "gives" if plan.reached else "is the most of the patterns, and does NOT give"
    lines = [
        f"{len(plan.stops)} images of {scene.plate.name}: {verdict} {want_px:g} px at 300 mm",
        "where a point will appear is known to (sigma, px; worst of the image):",
    ]
    for distance, sigma in zip(DISTANCES_MM, plan.projection_px, strict=True):
        lines.append(f"  {distance:>5.0f} mm  {sigma:.4f}")
    lines.append("predicted sigma of the parameters:")
    for name, sigma in zip(PARAMETERS, plan.sigma, strict=True):
        lines.append(f"  {name:<16} " + (f"{sigma:.3g}" if np.isfinite(sigma) else "stays open"))
    lines.append(
        f"for centres of {SIGMA_PX:g} px and stops of {1000 * scene.stop_sigma_mm:.1f} µm (sigma)"
    )
    for number, stop in enumerate(plan.stops, start=1):
        axes = "  ".join(
            f"{name} {np.degrees(value) if name in scene.kinematics.rotary else value:.1f}"
            for name, value in stop.axes.items()
        )
        lines.append(f"  {number:>3}  {axes}  ({len(stop.target_ids)} targets)")
    if plan.touch is not None:
        lines.append(
            f"touch target {plan.touch} before or after, and tell the height of its dot in machine"
            f" coordinates: touched: {{target: {plan.touch}, z_mm: ..., sigma_mm:"
            f" {scene.touch_sigma_mm:g}}}"
        )
    return lines + [f"finding: {words}" for words in plan.findings]


def program_lines(program: Program, plan: CalibrationPlan, control: str) -> list[str]:
    """Return what a written program does about the height to touch."""
    if plan.touch is None:
        return []
    if program.touch is None:
        return [
            f"the program does not touch target {plan.touch}: the spindle does not come to it from"
            " straight above; touch it by hand"
        ]
    if control != "linuxcnc":
        return [f"the program's last comments say how to touch target {plan.touch}"]
    return [
        f"the program touches target {plan.touch} at its end, once the length of the probe is"
        " written into it (_omm_probe_mm), and logs the line for set.yaml in omm_touched.txt"
    ]
