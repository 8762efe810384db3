"""A simulated control that runs a measuring program.

The program moves to each stop, dwells, asks for an image, waits until that is acknowledged (or
for as long as the program allows) and goes on. The control reports what a real one would: axis
positions as the scales see them, and an in-position flag that follows the *command*, so that it
is true before the machine has settled (LinuxCNC's `inpos` was measured to be true while the axis
was still 0.38 mm off). The truth, which the control does not know, can be asked for too.

Everything is a function of time and of the acknowledgements alone: the same times and events give
the same answers, in real time in a node or as fast as the computer goes in a test.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform
from omm_core.machine_errors import draw_stop_noise, lost_motion, spindle_drift
from omm_simulation.cell import Cell, random_stream
from omm_simulation.control_state import ControlState, ProgramState
from omm_simulation.motion import Follower, Profile, rest_to_rest
from omm_simulation.program import AskForImage, Dwell, MoveTo, Step, measuring_program

Floats = NDArray[np.float64]
AXIS_NAMES = ("X", "Y", "Z")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Move:
    start_ns: int
    profile: Profile
    start_mm: Floats
    change_mm: Floats
    start_error_mm: Floats
    change_error_mm: Floats

    @property
    def end_ns(self) -> int:
        return self.start_ns + round(self.profile.duration_s * 1e9)


@dataclass(frozen=True, kw_only=True)
class _Begun:
    """A step that has begun; `end_ns` is None while an image is waited for."""

    step: Step
    start_ns: int
    end_ns: int | None


class SimulatedControl:
    """A control, its program and its machine.

    Parameters
    ----------
    cell : Cell
        Brings the machine, the program's stops and the seed.
    start_ns : int
        When the program is started.
    speed_factor : float
        Runs all motion this many times as fast (velocity, acceleration and jerk scale with its
        powers 1, 2 and 3, so above 1 the machine's limits are exceeded accordingly); dwells, lag
        and settling keep their time.
    repetitions : int
        How often the stops are gone through.
    """

    def __init__(
        self, cell: Cell, *, start_ns: int = 0, speed_factor: float = 1.0, repetitions: int = 1
    ) -> None:
        machine = cell.scenario.machine
        self._machine = machine
        self._program = measuring_program(cell, repetitions)
        self._speed_factor = speed_factor
        self._servo = Follower(lag_s=machine.servo_lag_s)
        self._structure = Follower(
            lag_s=machine.servo_lag_s,
            frequency_hz=machine.structure_frequency_hz,
            damping=machine.structure_damping,
        )
        self._machine_R_spindle = RigidTransform.from_euler_xyz_rad(
            *machine.spindle_euler_xyz_rad
        ).rotation
        self._errors, self._declared = cell.errors, cell.scenario.errors
        self._rng = random_stream(cell.clamping_seed, "machine")
        self._signs = np.zeros(3)
        self._start_ns = start_ns
        self._timeout_ns = round(cell.scenario.program.acknowledge_timeout_s * 1e9)
        self._begun: list[_Begun] = []
        self._moves: list[_Move] = []
        self._acknowledged: list[tuple[int, int]] = []

    @property
    def program(self) -> tuple[Step, ...]:
        """The steps that the control runs."""
        return self._program

    def acknowledge(self, request: int, now_ns: int) -> bool:
        """Tell the program that an image is in; False where it does not wait for that one."""
        self._advance(now_ns)
        current = self._begun[-1] if self._begun else None
        waited_for = (
            current is not None
            and current.end_ns is None
            and isinstance(current.step, AskForImage)
            and current.step.request == request
        )
        if current is not None and waited_for:
            self._begun[-1] = _Begun(step=current.step, start_ns=current.start_ns, end_ns=now_ns)
            self._acknowledged.append((now_ns, request))
        return waited_for

    def state(self, time_ns: int) -> ControlState:
        """Return what the control says at a time (not before events that were already taken in)."""
        self._advance(time_ns)
        current = next((b for b in reversed(self._begun) if b.start_ns <= time_ns), None)
        commanded = self._commanded(time_ns)
        positions = _rounded(
            self._followed(time_ns, self._servo), self._machine.position_resolution_mm
        )
        waiting = (
            current is not None
            and isinstance(current.step, AskForImage)
            and (current.end_ns is None or time_ns < current.end_ns)
        )
        return ControlState(
            stamp_ns=time_ns,
            machine_T_spindle=self._pose(positions),
            axis_positions_mm=positions,
            axis_commanded_mm=commanded,
            in_position=(move := self._last_move(time_ns)) is None or time_ns >= move.end_ns,
            program_state=self._program_state(current, time_ns, waiting),
            program_line=current.step.line if current else 0,
            program_text=current.step.text if current else "",
            measure_request=next(
                (
                    b.step.request
                    for b in reversed(self._begun)
                    if isinstance(b.step, AskForImage) and b.start_ns <= time_ns
                ),
                0,
            ),
            measure_acknowledged=next(
                (
                    request
                    for when_ns, request in reversed(self._acknowledged)
                    if when_ns <= time_ns
                ),
                0,
            ),
            measure_requested=waiting,
        )

    def true_machine_T_spindle(self, time_ns: int) -> RigidTransform:
        """Return where the spindle truly is, which the control does not know."""
        self._advance(time_ns)
        return self._pose(self._followed(time_ns, self._structure) + self._error(time_ns))

    def finished(self, time_ns: int) -> bool:
        """Return whether the program has come to its end."""
        return self.state(time_ns).program_state is ProgramState.FINISHED

    def next_event_ns(self) -> int | None:
        """Return when the step that was begun last ends by itself; None at the program's end."""
        if not self._begun:
            return self._start_ns
        last = self._begun[-1]
        if last.end_ns is None:
            return last.start_ns + self._timeout_ns
        return last.end_ns if len(self._begun) < len(self._program) else None

    def _advance(self, now_ns: int) -> None:
        """Begin all steps that have begun by now."""
        while (when_ns := self.next_event_ns()) is not None and when_ns <= now_ns:
            if self._begun and self._begun[-1].end_ns is None:  # nobody sent the image
                last = self._begun[-1]
                self._begun[-1] = _Begun(step=last.step, start_ns=last.start_ns, end_ns=when_ns)
            if len(self._begun) == len(self._program):
                return
            self._begin(self._program[len(self._begun)], when_ns)

    def _begin(self, step: Step, start_ns: int) -> None:
        end_ns: int | None = None
        if isinstance(step, MoveTo):
            end_ns = self._begin_move(step, start_ns)
        elif isinstance(step, Dwell):
            end_ns = start_ns + round(step.duration_s * 1e9)
        self._begun.append(_Begun(step=step, start_ns=start_ns, end_ns=end_ns))

    def _begin_move(self, step: MoveTo, start_ns: int) -> int:
        start_mm = self._commanded(start_ns)
        change_mm = step.position_mm - start_mm
        if not np.any(change_mm):
            return start_ns
        start_error_mm = self._error_of_stop(start_ns)
        profile = self._profile(change_mm)
        error_mm = self._next_error_of_stop(change_mm, start_ns + round(profile.duration_s * 1e9))
        move = _Move(
            start_ns=start_ns,
            profile=profile,
            start_mm=start_mm,
            change_mm=change_mm,
            start_error_mm=start_error_mm,
            change_error_mm=error_mm - start_error_mm,
        )
        self._moves.append(move)
        return move.end_ns

    def _profile(self, change_mm: Floats) -> Profile:
        """Return the profile as fast as the slowest axis allows, all axes arriving together."""
        axes = [self._machine.axes[name] for name in AXIS_NAMES]
        lengths = np.maximum(np.abs(change_mm), 1e-12)
        factor = self._speed_factor
        return rest_to_rest(
            velocity=factor * float(np.min([a.velocity_mm_per_s for a in axes] / lengths)),
            acceleration=factor**2
            * float(np.min([a.acceleration_mm_per_s2 for a in axes] / lengths)),
            jerk=factor**3 * float(np.min([a.jerk_mm_per_s3 for a in axes] / lengths)),
        )

    def _commanded(self, time_ns: int) -> Floats:
        move = self._last_move(time_ns)
        if move is None:
            return np.array(self._machine.home_mm)
        along = move.profile.at((time_ns - move.start_ns) * 1e-9)[0]
        return move.start_mm + along * move.change_mm

    def _followed(self, time_ns: int, follower: Follower) -> Floats:
        """Return the command as a follower follows it: the responses to all moves add up."""
        moved_mm = np.zeros(3)
        for move in reversed(self._moves):
            along = follower.response(move.profile, (time_ns - move.start_ns) * 1e-9)
            moved_mm += along * move.change_mm
            if along == 1.0:  # then all moves before have settled too
                return move.start_mm + moved_mm
        return np.array(self._machine.home_mm) + moved_mm

    def _error(self, time_ns: int) -> Floats:
        """Return how far the spindle is from where the scales see it."""
        geometry = self._errors.geometry_mm(self._commanded(time_ns))
        return np.asarray(geometry + self._error_of_stop(time_ns))

    def _next_error_of_stop(self, change_mm: Floats, arrival_ns: int) -> Floats:
        """Draw a stop's error besides the geometry: at random, by its side, by warmth."""
        declared = self._declared
        self._signs = np.where(change_mm == 0.0, self._signs, np.sign(change_mm))
        noise = draw_stop_noise(self._rng, 1, declared.stop_sigma_mm)[0]
        drift = spindle_drift(
            (arrival_ns - self._start_ns) * 1e-9,
            declared.spindle_drift_mm,
            declared.spindle_drift_s,
        )
        return np.asarray(noise + lost_motion(self._signs, declared.lost_motion_mm) + drift)

    def _error_of_stop(self, time_ns: int) -> Floats:
        """Return a stop's error at any time: it changes from stop to stop."""
        move = self._last_move(time_ns)
        if move is None:
            return np.zeros(3)
        along = move.profile.at((time_ns - move.start_ns) * 1e-9)[0]
        return move.start_error_mm + along * move.change_error_mm

    def _last_move(self, time_ns: int) -> _Move | None:
        return next((m for m in reversed(self._moves) if m.start_ns <= time_ns), None)

    def _pose(self, positions_mm: Floats) -> RigidTransform:
        return RigidTransform(rotation=self._machine_R_spindle, translation_mm=positions_mm)

    def _program_state(self, current: _Begun | None, time_ns: int, waiting: bool) -> ProgramState:
        if current is None:
            return ProgramState.STOPPED
        if waiting:
            return ProgramState.WAITING
        at_end = current.step is self._program[-1] and current.end_ns is not None
        if at_end and current.end_ns is not None and time_ns >= current.end_ns:
            return ProgramState.FINISHED
        return ProgramState.RUNNING


def _rounded(positions_mm: Floats, resolution_mm: float) -> Floats:
    if resolution_mm <= 0.0:
        return positions_mm
    return np.round(positions_mm / resolution_mm) * resolution_mm
