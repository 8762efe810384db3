"""LinuxCNC behind the bridge's protocol. The reading is done by a child, see linuxcnc_reader.py."""

from __future__ import annotations

import json
import math
import os
import queue
import select
import subprocess
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omm_cnc_bridge.clock import ControlClock, ros_from_monotonic_ns
from omm_cnc_bridge.control import (
    ControlSample,
    Mode,
    Orientation,
    ProgramState,
    WorkOffset,
)
from omm_cnc_bridge.controls.linuxcnc import offsets
from omm_cnc_bridge.controls.linuxcnc.joint_axes import joint_axes
from omm_core.errors import DeviceError

LOCAL_READER = (
    "/usr/bin/python3",
    "-I",  # nothing of our own environment, least of all this folder's linuxcnc.py
    "-u",
    str(Path(__file__).with_name("linuxcnc_reader.py")),
)
HELLO_TIMEOUT_S = 5.0
HELLO = ("joints", "letters", "rotary", "linear_units_per_mm", "angular_units_per_degree",
         "sampled", "servo_s", "task_s")  # fmt: skip
ANSWER_TIMEOUT_S = 5.0
READ_BACK_S = 2.0  # for the status to say what a block has set
TRUTH_RATE_HZ = 250.0
_MODES = {1: Mode.MANUAL, 2: Mode.AUTOMATIC, 3: Mode.MDI}
# Of M19, in the terms of linuxcnc.RCS_DONE, RCS_EXEC and RCS_ERROR.
_ORIENTATIONS = {
    0: Orientation.FREE, 1: Orientation.HELD, 2: Orientation.TURNING, 3: Orientation.FAULT
}  # fmt: skip
_PAUSED = 3  # linuxcnc.INTERP_PAUSED
_IDLE = 1


class LinuxCncControl:
    """A LinuxCNC on this machine, or on another one through a command such as ssh.

    Parameters
    ----------
    reader : sequence of str
        Command that starts linuxcnc_reader.py beside LinuxCNC; empty starts it here.
    joint_names : sequence of str
        Axis that each joint is; empty takes the letters of LinuxCNC's configuration.
    program_file : str
        What ``start_program`` starts; a path on the control.
    """

    name = "linuxcnc"

    def __init__(
        self,
        *,
        rate_hz: float,
        reader: Sequence[str] = (),
        joint_names: Sequence[str] = (),
        program_file: str = "",
        poll: bool = False,
    ) -> None:
        self.clock = ControlClock()
        self._reader = tuple(reader or LOCAL_READER)
        self._options = ("--rate-hz", str(rate_hz), *(("--poll",) if poll else ()))
        self._given_names = tuple(joint_names)
        self._names: tuple[str, ...] = ()
        self._followers: dict[str, str] = {}
        self._program_file = program_file
        self._child: subprocess.Popen[bytes] | None = None
        self._rest = b""
        self._hello: dict[str, Any] = {}
        self._status: dict[str, Any] = {}
        self._numbers = 0
        self._answers: dict[int, queue.Queue[str]] = {}
        self._corrections: set[int] = set()  # numbers of commands whose answer nobody waits for
        self._notes: tuple[str, ...] = ()
        self._writing = threading.Lock()

    def connect(self) -> None:
        """Start the reader and wait until it has found LinuxCNC."""
        self._end_reader()
        try:
            self._child = subprocess.Popen(
                [*self._reader, *self._options],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
            )
        except OSError as error:
            raise DeviceError(f"Expected to start {self._reader[0]}: {error}.") from error
        self._rest, self._hello, self._status = b"", {}, {}
        self.clock = ControlClock()
        deadline = time.monotonic() + HELLO_TIMEOUT_S
        while not self._hello:
            if time.monotonic() > deadline:
                raise DeviceError("LinuxCNC's reader says nothing.")
            self.read(0.1)

    def read(self, timeout_s: float) -> Sequence[ControlSample]:
        """Return the samples that the reader has sent, oldest first."""
        samples: list[ControlSample] = []
        for line in self._lines(timeout_s):
            try:
                message = json.loads(line)
            except ValueError as error:
                text = line[:80].decode(errors="replace")
                raise DeviceError(f"LinuxCNC's reader says {text!r}, which is not JSON.") from error
            if "samples" in message:
                received_ns = time.monotonic_ns()
                samples += [self._sample(row, received_ns) for row in message["samples"]]
            elif "status" in message:
                self._status = message["status"]
            elif "hello" in message:
                self._on_hello(message["hello"])
            elif "answer" in message:
                self._on_answer(message["answer"])
            elif "lost" in message:
                raise DeviceError(f"LinuxCNC: {message['lost']}.")
        return samples

    def acknowledge(self, request: int) -> None:
        """Set the HAL signal that the program's M66 waits for; it falls when the request does."""
        del request  # LinuxCNC's handshake has one image at a time
        self._send(do="acknowledge")

    def correct(self, shift_mm: tuple[float, float, float], status: int, *, valid: bool) -> None:
        """Set the HAL signals that the program reads with its next answer.

        Where HAL does not have them the samples' notes say so, and the program, which finds no
        valid correction, goes on as planned.
        """
        self._corrections.add(
            self._send(do="correct", valid=valid, values=[*shift_mm, float(status)])
        )

    def start_program(self) -> None:
        """Run the program that LinuxCNC was started with."""
        self._ask(ANSWER_TIMEOUT_S, do="run", text=self._program_file)

    def mdi(self, text: str, timeout_s: float = ANSWER_TIMEOUT_S) -> None:
        """Carry out one block, for instance ``G10 L2 P1 X… Y… Z… R…`` (sets a work offset)."""
        self._ask(timeout_s, do="mdi", text=text)

    def work_offset(self, name: str) -> WorkOffset:
        """Return an offset; LinuxCNC tells it only of the one that is active."""
        return offsets.read(self._status, name, self._per_mm())

    def set_work_offset(self, offset: WorkOffset, timeout_s: float) -> WorkOffset:
        """Write an offset with ``G10 L2``, make it active for a moment, and read it back.

        Units and distance mode are left as they were found, and so is the active offset.
        """
        before = dict(self._status)
        block = offsets.block(before, offset)
        self.mdi(block, timeout_s)
        try:
            self.mdi(offset.name, timeout_s)
            deadline = time.monotonic() + READ_BACK_S
            while True:
                told = offsets.told(self._status, offset.name, self._per_mm())
                late = time.monotonic() > deadline
                if late or (told is not None and offsets.equal(told, offset)):
                    break
                time.sleep(0.02)
        finally:
            for word in offsets.restoring(before):
                self.mdi(word, timeout_s)
        if told is None:
            raise DeviceError(f"LinuxCNC: {offset.name} did not become active: not read back.")
        return told

    def _per_mm(self) -> float:
        if not self._hello:
            raise DeviceError("LinuxCNC is not connected.")
        return float(self._hello["linear_units_per_mm"])

    def close(self) -> None:
        """End the reader; LinuxCNC goes on."""
        self._end_reader()

    # --- the child -----------------------------------------------------------------------------

    def _end_reader(self) -> None:
        child, self._child = self._child, None
        for waiting in list(self._answers.values()):
            waiting.put("the connection ended before it answered")
        if child is None:
            return
        for stream in (child.stdin, child.stdout):
            if stream is not None:
                stream.close()  # which ends the reader
        try:
            child.wait(1.0)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()

    def _lines(self, timeout_s: float) -> list[bytes]:
        child = self._child
        if child is None or child.stdout is None:
            raise DeviceError("LinuxCNC is not connected.")
        if not select.select([child.stdout], [], [], timeout_s)[0]:
            return []
        data = os.read(child.stdout.fileno(), 1 << 20)
        if not data:
            raise DeviceError("LinuxCNC's reader has ended.")
        *lines, self._rest = (self._rest + data).split(b"\n")
        return lines

    def _send(self, **command: object) -> int:
        with self._writing:
            self._numbers += 1
            line = json.dumps({"number": self._numbers, **command}).encode() + b"\n"
            child = self._child
            try:
                if child is None or child.stdin is None:
                    raise DeviceError("LinuxCNC is not connected.")
                child.stdin.write(line)
            except (OSError, ValueError) as error:
                raise DeviceError(f"LinuxCNC's reader does not listen: {error}.") from error
            return self._numbers

    def _ask(self, timeout_s: float, **command: object) -> None:
        """Send a command from another thread than the one that reads; wait for its answer."""
        answer: queue.Queue[str] = queue.Queue()
        self._answers[self._numbers + 1] = answer
        number = self._send(**command)
        try:
            error = answer.get(timeout=timeout_s)
        except queue.Empty:
            error = f"not done within {timeout_s:g} s; it was not stopped"
        finally:
            self._answers.pop(number, None)
        if error:
            raise DeviceError(f"LinuxCNC: {error}.")

    def _on_answer(self, answer: dict[str, Any]) -> None:
        if answer["number"] in self._corrections:
            self._corrections.discard(answer["number"])
            if answer["error"]:
                self._notes = (f"the program cannot be led: {answer['error']}",)
            return
        waiting = self._answers.get(answer["number"])
        if waiting is not None:
            waiting.put(answer["error"])
        elif answer["error"]:
            raise DeviceError(f"LinuxCNC: {answer['error']}.")

    def _on_hello(self, hello: dict[str, Any]) -> None:
        if missing := [key for key in HELLO if key not in hello]:
            raise DeviceError(
                f"Expected {', '.join(missing)} from LinuxCNC's reader, too: copy the"
                " linuxcnc_reader.py of this omm to the control."
            )
        self._hello = hello
        self._names, self._followers = joint_axes(
            self._given_names, hello["letters"], hello["joints"]
        )

    # --- samples -------------------------------------------------------------------------------

    def _sample(self, row: list[Any], received_ns: int) -> ControlSample:
        try:
            number, measured, commanded, in_position, wanted, image, _ = row
            complete = len(measured) == len(commanded) == len(self._names)
            complete &= all(_is_number(value) for value in (number, image))
        except (TypeError, ValueError):
            complete = False
        if not complete:
            # A shorter row, believed, would have the last axes stand nowhere without a word.
            raise DeviceError(
                f"Expected positions of {len(self._names)} joints from LinuxCNC's reader, got"
                f" {str(row)[:80]}."
            )
        hello, status = self._hello, self._status
        half_cycle_ns = round(0.5e9 * hello["servo_s"])
        if hello["sampled"]:
            control_ns = round(number * hello["servo_s"] * 1e9)
        else:  # what is polled was copied from motion by the task, one cycle of each ago on average
            half_cycle_ns += round(0.5e9 * hello["task_s"])
            control_ns = number - half_cycle_ns
        ours_ns, clock_ns = self.clock.observe(control_ns, received_ns)
        uncertainty_ns = (
            clock_ns if hello["sampled"] else round(math.hypot(clock_ns, half_cycle_ns))
        )
        return ControlSample(
            stamp_ns=ros_from_monotonic_ns(ours_ns),
            stamp_uncertainty_ns=uncertainty_ns,
            positions=self._named(measured),
            unusable={
                name: f"{value!r:.80} is not a number"
                for name, value in zip(self._names, measured)
                if not _is_number(value)
            },
            turning=dict(zip(self._names, hello["rotary"])),
            followers=self._followers,
            commanded=self._named(commanded),
            in_position=bool(in_position),
            fault=self._fault(),
            mode=_MODES.get(status.get("mode", 0), Mode.UNKNOWN),
            program_state=_program_state(status),
            program=os.path.basename(status.get("program", "")),
            program_line=status.get("line", -1),
            measure_request=round(image) if wanted else None,
            notes=self._notes,
            orientation=_ORIENTATIONS.get(status.get("orientation", -1), Orientation.UNKNOWN),
            spindle_angle_rad=math.radians(_or_nan(status.get("spindle_deg"))),
        )

    def _named(self, values: list[float]) -> dict[str, float]:
        """Return the joint positions by name, in mm and rad."""
        per_mm = self._hello["linear_units_per_mm"]
        per_rad = math.degrees(1.0) * self._hello["angular_units_per_degree"]
        rotary = self._hello["rotary"]
        return {
            name: value / (per_rad if turns else per_mm)
            for name, value, turns in zip(self._names, values, rotary)
            if _is_number(value)
        }

    def _fault(self) -> str | None:
        if not self._status:
            return "LinuxCNC's status is not known yet"
        homed = zip(self._names, self._status["homed"])
        lost = [name for name, is_homed in homed if not is_homed]
        return f"not referenced: {', '.join(lost)}" if lost else None


def _program_state(status: dict[str, Any]) -> ProgramState:
    if not status:
        return ProgramState.UNKNOWN
    if status["interpreter"] == _IDLE:
        return ProgramState.FINISHED if status["finished"] else ProgramState.STOPPED
    if status["interpreter"] == _PAUSED:
        return ProgramState.INTERRUPTED
    return ProgramState.WAITING if status["waiting"] else ProgramState.RUNNING


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
