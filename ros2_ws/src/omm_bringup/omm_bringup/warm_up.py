"""Compile all kernels once, so that no measurement waits for the compiler (see ./omm).

python -m omm_bringup.warm_up rendering | measuring
"""

import sys

import numpy as np

from omm_core.geometry import RigidTransform
from omm_core.warm_up import warm_up_detection, warm_up_estimation


def rendering() -> None:
    """Everything that the simulated camera needs, at rest and in motion."""
    from omm_simulation.camera import SimulatedCamera
    from omm_simulation.cell import draw
    from omm_simulation.scenario import load_scenario

    cell = draw(load_scenario("bench"), 1)
    at = cell.stops[0].spindle_in_machine_mm
    camera = SimulatedCamera(cell)
    for moved_mm in (0.0, 0.5):
        poses = [
            RigidTransform(rotation=np.eye(3), translation_mm=at + [share * moved_mm, 0.0, 0.0])
            for share in (0.0, 1.0)
        ]
        camera.image(poses, frame=1)


def measuring() -> None:
    """Everything from an image to the estimate."""
    warm_up_detection()
    warm_up_estimation()


if __name__ == "__main__":
    {"rendering": rendering, "measuring": measuring}[sys.argv[1]]()
