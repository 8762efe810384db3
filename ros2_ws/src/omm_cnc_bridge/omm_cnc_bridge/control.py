"""What every control looks like to the bridge: a small protocol and the samples that it yields."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol, runtime_checkable

from omm_cnc_bridge.clock import ControlClock
from omm_core.geometry import RigidTransform


class Mode(IntEnum):
    """Mode of the control; the numbers are those of ``omm_interfaces/SpindleState``."""

    UNKNOWN = 0
    MANUAL = 1
    MDI = 2
    AUTOMATIC = 3


class ProgramState(IntEnum):
    """State of the part program; the numbers are those of ``omm_interfaces/SpindleState``."""

    UNKNOWN = 0
    STOPPED = 1
    RUNNING = 2
    WAITING = 3
    INTERRUPTED = 4
    FINISHED = 5


class Orientation(IntEnum):
    """Of the spindle; the numbers are those of ``omm_interfaces/SpindleState``."""

    UNKNOWN = 0
    FREE = 1
    TURNING = 2
    HELD = 3
    FAULT = 4


class Connection(IntEnum):
    """How well the control is heard; the numbers are those of ``omm_interfaces/SpindleState``."""

    DISCONNECTED = 0
    CONNECTING = 1
    CONNECTED = 2
    STALE = 3


@dataclass(frozen=True, kw_only=True)
class Unseen:
    """By how much, and for how long, an axis may have moved without a word of the control."""

    distance: float = 0.0
    """mm or rad."""
    seconds: float = 0.0
    why: str = ""
    """What hides it, in the control's own terms."""


@dataclass(frozen=True, kw_only=True)
class ControlSample:
    """What a control said of itself at one moment.

    Lengths are mm, angles rad; which of the two an axis has is the machine's description's to say.
    """

    stamp_ns: int
    """ROS time at which the positions were true."""
    stamp_uncertainty_ns: int
    """Standard deviation of ``stamp_ns``."""
    positions: Mapping[str, float]
    """Measured position by axis name, mm or rad."""
    commanded: Mapping[str, float] = field(default_factory=dict)
    """Commanded position by axis name, mm or rad; axes are missing where the control is silent."""
    unusable: Mapping[str, str] = field(default_factory=dict)
    """Why a position that the control has cannot be used, by axis; refused unless ignored."""
    turning: Mapping[str, bool] = field(default_factory=dict)
    """Whether an axis turns, by the control's own word; axes are missing where it has none."""
    unseen: Mapping[str, Unseen] = field(default_factory=dict)
    """What motion the control keeps to itself (a filter of an agent), by axis."""
    followers: Mapping[str, str] = field(default_factory=dict)
    """Axis that each second drive goes with (gantry), as the control's configuration says."""
    notes: tuple[str, ...] = ()
    """What was chosen where the control says a thing twice; told once."""
    in_position: bool | None = None
    """The control's own word; None where it has none."""
    fault: str | None = None
    """Why the positions must not be used although they arrived (axis not referenced, lost, …)."""
    mode: Mode = Mode.UNKNOWN
    program_state: ProgramState = ProgramState.UNKNOWN
    program: str = ""
    program_line: int = -1
    measure_request: int | None = None
    """Number of the image that the program waits for now; None where it waits for none."""
    orientation: Orientation = Orientation.UNKNOWN
    spindle_angle_rad: float = math.nan
    """As the control counts it; NaN where it does not tell."""


class Control(Protocol):
    """A control behind a real or simulated connection.

    One thread calls all methods, except ``acknowledge`` and those that give commands, which any
    thread may call.
    """

    name: str
    """``linuxcnc``, ``opcua``, ``mtconnect`` or ``simulated``."""

    def connect(self) -> None:
        """Connect, or connect again. Raises DeviceError where nothing answers."""

    def read(self, timeout_s: float) -> Sequence[ControlSample]:
        """Return the samples since the last call, oldest first; wait for the first of them.

        Empty when none came within ``timeout_s``. Raises DeviceError when the connection is lost.
        """

    def acknowledge(self, request: int) -> None:
        """Tell the program that image ``request`` is taken. Raises DeviceError where it cannot."""

    def close(self) -> None:
        """Disconnect; the control goes on undisturbed. Never raises, may be called twice."""


@runtime_checkable
class KeepsTime(Protocol):
    """A control that stamps its samples by a clock of its own."""

    @property
    def clock(self) -> ControlClock:
        """How that clock relates to ours."""


@runtime_checkable
class SamplesAtIntervals(Protocol):
    """A control whose server decides how often it gives a sample."""

    @property
    def revised_interval_s(self) -> float | None:
        """The interval that it keeps; None while not connected."""


@runtime_checkable
class StartsPrograms(Protocol):
    """A control that can be told to start its measuring program."""

    def start_program(self) -> None:
        """Start the program from its beginning. Raises DeviceError where that is refused."""


@runtime_checkable
class TakesBlocks(Protocol):
    """A control that carries out single blocks (MDI)."""

    def mdi(self, text: str, timeout_s: float) -> None:
        """Carry out one block; return when it is done. Any thread may call this.

        Raises DeviceError where the block is refused, fails or is not done in time.
        """


@runtime_checkable
class TakesCorrections(Protocol):
    """A control whose measuring program can be told where the next stop shall be."""

    def correct(self, shift_mm: tuple[float, float, float], status: int, *, valid: bool) -> None:
        """Set the correction read with the next answer: a shift of X, Y, Z, and its status.

        Raises DeviceError where the control is not connected.
        """


@dataclass(frozen=True, kw_only=True)
class WorkOffset:
    """A work offset: machine_T_part as the control has it.

    Angles are about fixed x, y, z: ``R = Rz(γ) Ry(β) Rx(α)``.
    """

    name: str
    xyz_mm: tuple[float, float, float]
    euler_xyz_rad: tuple[float, float, float]


@runtime_checkable
class HasOffsets(Protocol):
    """A control of which work offsets can be read and written. Any thread may call this."""

    def work_offset(self, name: str) -> WorkOffset:
        """Return an offset as the control has it. Raises DeviceError where it does not tell."""

    def set_work_offset(self, offset: WorkOffset, timeout_s: float) -> WorkOffset:
        """Write an offset, read it back and return what was read.

        Raises DeviceError where the control has no such offset, cannot say the numbers, or refuses.
        """


@dataclass(frozen=True, kw_only=True)
class TruePose:
    """Where the spindle of a simulated machine truly was."""

    stamp_ns: int
    machine_T_spindle: RigidTransform


@runtime_checkable
class KnowsTruth(Protocol):
    """A simulated machine, which tells the simulated camera what the control does not know."""

    def read_truth(self) -> Sequence[TruePose]:
        """Return where the spindle truly was since the last call, oldest first."""
