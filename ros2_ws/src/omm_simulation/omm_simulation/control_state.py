"""What a simulated control says of itself."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform

Floats = NDArray[np.float64]


class ProgramState(Enum):
    """What the program is doing."""

    STOPPED = "stopped"
    RUNNING = "running"
    WAITING = "waiting"
    """For an image to be acknowledged."""
    FINISHED = "finished"


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlState:
    """What the control says of itself at one time.

    Attributes
    ----------
    stamp_ns : int
        When this is true.
    machine_T_spindle : RigidTransform
        As the axes' scales see it.
    axis_positions_mm, axis_commanded_mm : ndarray, shape (3,)
        X, Y, Z: measured, and as commanded at that time.
    in_position : bool
        The command has reached its end; the machine may still be on its way.
    program_state : ProgramState
    program_line : int
        Line number of the step that is carried out, 0 before the first.
    program_text : str
        That line.
    measure_request : int
        Number of the last image that was asked for; 0 before the first.
    measure_acknowledged : int
        Number of the last image that was acknowledged.
    measure_requested : bool
        The program waits for image `measure_request`.
    """

    stamp_ns: int
    machine_T_spindle: RigidTransform
    axis_positions_mm: Floats
    axis_commanded_mm: Floats
    in_position: bool
    program_state: ProgramState
    program_line: int
    program_text: str
    measure_request: int
    measure_acknowledged: int
    measure_requested: bool
