"""Compile all kernels of the simulated camera once, at rest and in motion.

python -m omm_simulation.warm_up
"""

import numpy as np

from omm_core.geometry import RigidTransform
from omm_simulation.camera import SimulatedCamera
from omm_simulation.cell import draw
from omm_simulation.scenario import load_scenario


def main() -> None:
    """Render an image of each kind."""
    cell = draw(load_scenario("bench"), 1)
    at = cell.stops[0].spindle_in_machine_mm
    camera = SimulatedCamera(cell)
    for moved_mm in (0.0, 0.5):
        poses = [
            RigidTransform(rotation=np.eye(3), translation_mm=at + [share * moved_mm, 0.0, 0.0])
            for share in (0.0, 1.0)
        ]
        camera.image(poses, frame=1)


if __name__ == "__main__":
    main()
