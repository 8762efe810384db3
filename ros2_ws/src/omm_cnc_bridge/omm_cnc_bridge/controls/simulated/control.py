"""The simulated control of ``omm_simulation``, run in real time behind the bridge's protocol."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

import numpy as np

from omm_cnc_bridge.clock import ros_from_monotonic_ns
from omm_cnc_bridge.control import ControlSample, Mode, ProgramState, TruePose, WorkOffset
from omm_core.errors import DeviceError
from omm_core.geometry import RigidTransform
from omm_core.machine.kinematics import Kinematics
from omm_core.machine.urdf import Joint, Robot
from omm_simulation.cell import Cell
from omm_simulation.control import AXIS_NAMES, SimulatedControl
from omm_simulation.control_state import ControlState
from omm_simulation.scenario import Scenario

OFFSETS = ("G54", "G55", "G56", "G57", "G58", "G59")
_PROGRAM_STATES = {state.name: state for state in ProgramState}


class SimulatedCellControl:
    """A control that runs a cell's measuring program once it is told to.

    Parameters
    ----------
    rate_hz : float
        Samples per second; the truth comes at least twice as often.
    """

    name = "simulated"

    def __init__(
        self, cell: Cell, *, rate_hz: float, speed_factor: float = 1.0, repetitions: int = 1
    ) -> None:
        self._cell = cell
        self._speed_factor, self._repetitions = speed_factor, repetitions
        self._truths_per_sample = max(1, round(250.0 / rate_hz))
        self._tick_ns = round(1e9 / (rate_hz * self._truths_per_sample))
        self._lock = threading.Lock()
        self._control = self._halted()
        self._epoch_ns = 0
        self._tick = 0
        self._truth: list[TruePose] = []
        self._offsets: dict[str, WorkOffset] = {}

    def connect(self) -> None:
        """Start the control; its program waits to be started."""
        self._epoch_ns = time.monotonic_ns()
        self._tick = 0

    def start_program(self) -> None:
        """Start the measuring program from its beginning."""
        with self._lock:
            self._control = SimulatedControl(
                self._cell,
                start_ns=time.monotonic_ns() + self._tick_ns,
                speed_factor=self._speed_factor,
                repetitions=self._repetitions,
            )

    def read(self, timeout_s: float) -> Sequence[ControlSample]:
        """Return the sample of the next tick, once that has come."""
        del timeout_s  # the next sample is never further away than that
        while True:
            self._tick += 1
            due_ns = self._epoch_ns + self._tick * self._tick_ns
            behind_ns = time.monotonic_ns() - due_ns
            if behind_ns < 0:
                time.sleep(-behind_ns / 1e9)
            with self._lock:
                pose = self._control.true_machine_T_spindle(due_ns)
                state = self._control.state(due_ns)
            stamp_ns = ros_from_monotonic_ns(due_ns)
            self._truth.append(TruePose(stamp_ns=stamp_ns, machine_T_spindle=pose))
            if self._tick % self._truths_per_sample == 0:
                return (_sample(state, stamp_ns, self._cell.scenario.name),)

    def read_truth(self) -> Sequence[TruePose]:
        """Return where the spindle truly was since the last call."""
        truth, self._truth = self._truth, []
        return truth

    def acknowledge(self, request: int) -> None:
        """Tell the simulated program that its image is in."""
        with self._lock:
            taken = self._control.acknowledge(request, time.monotonic_ns())
        if not taken:
            raise DeviceError(f"The simulated program does not wait for image {request}.")

    def work_offset(self, name: str) -> WorkOffset:
        """Return an offset out of a table that begins with zeros, as a real control has it."""
        if name not in OFFSETS:
            raise DeviceError(f"Expected one of the offsets {', '.join(OFFSETS)}, got {name}.")
        zero = WorkOffset(name=name, xyz_mm=(0.0, 0.0, 0.0), euler_xyz_rad=(0.0, 0.0, 0.0))
        return self._offsets.get(name, zero)

    def set_work_offset(self, offset: WorkOffset, timeout_s: float) -> WorkOffset:
        """Take an offset into the table."""
        del timeout_s  # done at once
        self.work_offset(offset.name)
        self._offsets[offset.name] = offset
        return self.work_offset(offset.name)

    def close(self) -> None:
        """Do nothing: no connection is held open."""

    def _halted(self) -> SimulatedControl:
        """Return a control whose program does not start by itself."""
        return SimulatedControl(self._cell, start_ns=2**62)


def _sample(state: ControlState, stamp_ns: int, program: str) -> ControlSample:
    positions, commanded = state.axis_positions_mm.tolist(), state.axis_commanded_mm.tolist()
    return ControlSample(
        stamp_ns=stamp_ns,
        stamp_uncertainty_ns=0,
        positions=dict(zip(AXIS_NAMES, positions, strict=True)),
        commanded=dict(zip(AXIS_NAMES, commanded, strict=True)),
        in_position=state.in_position,
        mode=Mode.AUTOMATIC,
        program_state=_PROGRAM_STATES[state.program_state.name],
        program=program,
        program_line=state.program_line,
        measure_request=state.measure_request if state.measure_requested else None,
    )


def machine_of(scenario: Scenario) -> Kinematics:
    """Return a scenario's machine: X, Y and Z, and the spindle as it is mounted."""
    links = ("machine", *AXIS_NAMES, "spindle")
    axes = scenario.machine.axes
    joints = [
        Joint(
            name=name,
            movable=True,
            rotary=False,
            parent=links[i],
            child=links[i + 1],
            origin=np.eye(4),
            axis=np.eye(3)[i],
            lower=axes[name].minimum_mm,
            upper=axes[name].maximum_mm,
        )
        for i, name in enumerate(AXIS_NAMES)
    ]
    mounted = np.eye(4)
    mounted[:3, :3] = RigidTransform.from_euler_xyz_rad(
        *scenario.machine.spindle_euler_xyz_rad
    ).rotation
    spindle = Joint(
        name="mount",
        movable=False,
        rotary=False,
        parent=AXIS_NAMES[-1],
        child="spindle",
        origin=mounted,
        axis=np.array([1.0, 0.0, 0.0]),
        lower=-np.inf,
        upper=np.inf,
    )
    robot = Robot(name=scenario.name, root="machine", links=links, joints=(*joints, spindle))
    return Kinematics(robot)
