"""The measuring program: approach, stop, dwell, ask for an image, rest, and on to the next."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform
from omm_simulation.cell import Cell


@dataclass(frozen=True, kw_only=True, eq=False)
class MoveTo:
    """Go straight to a position of X, Y, Z and stop there."""

    line: int
    position_mm: NDArray[np.float64]

    @property
    def text(self) -> str:
        """The block as a control shows it."""
        x, y, z = self.position_mm
        return f"N{self.line} G0 X{x:.3f} Y{y:.3f} Z{z:.3f}"


@dataclass(frozen=True, kw_only=True)
class Dwell:
    """Rest."""

    line: int
    duration_s: float

    @property
    def text(self) -> str:
        """The block as a control shows it."""
        return f"N{self.line} G4 P{self.duration_s:g}"


@dataclass(frozen=True, kw_only=True)
class AskForImage:
    """Ask for image `request` (of a target) and wait until it is acknowledged."""

    line: int
    request: int
    target_id: int

    @property
    def text(self) -> str:
        """The block as a control shows it."""
        return f"N{self.line} (image {self.request}, target {self.target_id})"


Step = MoveTo | Dwell | AskForImage


def measuring_program(cell: Cell, repetitions: int = 1) -> tuple[Step, ...]:
    """Return the steps of a cell's program.

    Between targets the spindle backs off by the program's `retract_mm` along its axis.
    """
    program = cell.scenario.program
    back_off = _away_from_part(cell) * program.retract_mm
    steps: list[Step] = []

    def next_line() -> int:
        return 10 * (len(steps) + 1)

    def move_to(position_mm: NDArray[np.float64]) -> None:
        steps.append(MoveTo(line=next_line(), position_mm=position_mm))

    request = 0
    for _ in range(repetitions):
        for i, stop in enumerate(cell.stops):
            first_of_target = i == 0 or cell.stops[i - 1].target_id != stop.target_id
            if first_of_target and program.retract_mm > 0.0:
                if i > 0:
                    move_to(cell.stops[i - 1].spindle_in_machine_mm + back_off)
                move_to(stop.spindle_in_machine_mm + back_off)
            move_to(stop.spindle_in_machine_mm)
            steps.append(Dwell(line=next_line(), duration_s=program.dwell_s))
            request += 1
            steps.append(AskForImage(line=next_line(), request=request, target_id=stop.target_id))
            steps.append(Dwell(line=next_line(), duration_s=program.rest_after_s))
    return tuple(steps)


def _away_from_part(cell: Cell) -> NDArray[np.float64]:
    """Return the spindle's axis, from the tool to the spindle, in `machine`."""
    rotation = RigidTransform.from_euler_xyz_rad(
        *cell.scenario.machine.spindle_euler_xyz_rad
    ).rotation
    return rotation[:, 2]
