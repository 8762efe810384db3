"""What the simulated cameras see: the cell of a scenario, rendered."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from omm_camera_driver.drivers.simulated.true_poses import PoseAt
from omm_core.geometry import RigidTransform
from omm_simulation.camera import SimulatedCamera
from omm_simulation.cell import Cell, draw
from omm_simulation.scenario import load_scenario


class CellView:
    """A cell as its camera sees it.

    Parameters
    ----------
    cell : Cell
    """

    def __init__(self, cell: Cell) -> None:
        calibration = cell.scenario.calibration
        self.name = f"{cell.scenario.name}-{cell.seed}"
        self.width_px, self.height_px = calibration.width_px, calibration.height_px
        self.exposure_ns = round(cell.scenario.imaging.exposure_s * 1e9)
        self._cell, self._camera = cell, SimulatedCamera(cell)
        self._first_stop = RigidTransform.from_euler_xyz_rad(
            *cell.scenario.machine.spindle_euler_xyz_rad,
            translation_mm=cell.stops[0].spindle_in_machine_mm,
        )

    def warm_up(self) -> None:
        """Render once, so that the first image does not wait for the compiler."""
        self._camera.image(self._first_stop, frame=0)

    def place_part(self, machine_T_part: RigidTransform | None) -> None:
        """Move the part from now on; None: back to where it stands."""
        if machine_T_part is not None and machine_T_part is not self._cell.machine_T_part:
            self._cell = replace(self._cell, machine_T_part=machine_T_part)
            self._camera = SimulatedCamera(self._cell)

    def render(
        self, pose_at: PoseAt, middle_ns: int, exposure_ns: int, *, frame: int, bits: int = 8
    ) -> NDArray[np.generic]:
        """Return an image (height, width) uint8 or uint16.

        Parameters
        ----------
        pose_at : machine_T_spindle at a time in ns
        middle_ns, exposure_ns : when, and for how long; the light makes up for another duration
        frame : the same number makes the same noise
        bits : 8 or 16
        """
        # The scenario's exposure is stretched to the one asked for.
        stretch = exposure_ns / self.exposure_ns

        def stretched(time_ns: int) -> RigidTransform:
            return pose_at(middle_ns + round((time_ns - middle_ns) * stretch))

        poses = self._camera.exposure_poses(stretched, middle_ns)
        return self._camera.image(poses, frame=frame, bits=bits)


def cell_view(
    scenario: str, seed: int, *, clamping_seed: int = -1, repeat: int = 1, bumped_id: int = -1
) -> CellView:
    """Return the view of a scenario's cell; -1 leaves an option out.

    Raises
    ------
    InputError
        There is no such scenario or target.
    """
    return CellView(
        draw(
            load_scenario(scenario),
            seed,
            clamping_seed=None if clamping_seed < 0 else clamping_seed,
            repeat=repeat,
            bumped_id=None if bumped_id < 0 else bumped_id,
        )
    )
