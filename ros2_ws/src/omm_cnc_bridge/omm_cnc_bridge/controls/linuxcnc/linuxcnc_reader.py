"""Reads LinuxCNC for the bridge; run as a disposable child, with the Python that LinuxCNC is for.

Needs nothing but the standard library and LinuxCNC's own module, so that it can also be copied to
the control and run there (``ssh control python3 -u linuxcnc_reader.py``). Writes one JSON object a
line to its standard output, reads commands from its standard input, and ends when that closes.

Why a child (all of it seen with LinuxCNC 2.9):

- When LinuxCNC stops or restarts, a ``linuxcnc.stat`` goes on returning the old values without an
  error. The processes and the shared memory that it reads are therefore watched.
- A process that holds a stale ``stat`` and ends normally deletes the semaphore of the session that
  runs now, and breaks it. This one ends by ``os._exit``, always.
- Polling before LinuxCNC is up fails, and goes on failing in that process. This one waits for the
  server's shared memory, and is simply started again where it fails nevertheless.
- HAL's sampler counts only what it stored: after its buffer ran full (4 s) samples are missing
  without a trace. Whoever was not read for 2 s starts again.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import subprocess
import sys
import time
from typing import Any

STATUS_KEY = 1002  # of NML's status buffer, in linuxcnc.nml
STALL_S = 2.0  # half of what the sampler's buffer holds
STATUS_PERIOD_S = 0.02
ANGLE_PERIOD_S = 0.5
LIVENESS_PERIOD_S = 0.05
LIVENESS_LIMIT_S = 0.25
SIGNAL_TAKEN = "omm-image-taken"
SIGNAL_VALID = "omm-correction-valid"
SIGNALS_CORRECTION = (
    "omm-correction-x", "omm-correction-y", "omm-correction-z", "omm-correction-status",
)  # fmt: skip
MODAL = (200, 210, 900, 910)  # G20, G21, G90, G91 in LinuxCNC's count


class Lost(Exception):
    """LinuxCNC is not there, or no longer the one that was connected to."""


class BridgeGone(Exception):
    """Nobody is there to read for."""


def tell(**message: object) -> None:
    """Send one line to the bridge, at once."""
    try:
        os.write(1, json.dumps(message, separators=(",", ":")).encode() + b"\n")
    except BrokenPipeError as error:
        raise BridgeGone from error


class Alive:
    """Whether the processes that make the data are there and run."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._shm = _status_memory()
        if self._shm is None:
            raise Lost("no LinuxCNC runs here")
        self._pids = {name: _pid_of(name) for name in names}
        missing = [name for name, pid in self._pids.items() if pid is None]
        if missing:
            raise Lost(f"LinuxCNC runs without {', '.join(missing)}")
        self._ran = {name: (0, time.monotonic()) for name in names}

    def check(self, *, polled: bool) -> None:
        """Raise Lost where LinuxCNC ended, was started anew, or stands still.

        A process that a busy machine lets wait for its turn is not lost, except where what is
        ``polled`` would be taken for news meanwhile.
        """
        now = time.monotonic()
        if _status_memory() != self._shm:
            raise Lost("LinuxCNC has ended or was started anew")
        for name, pid in self._pids.items():
            ran_ns = _run_time_ns(pid or 0)
            if ran_ns is None:
                raise Lost(f"LinuxCNC's {name} has ended")
            before_ns, since = self._ran[name]
            if ran_ns != before_ns:
                self._ran[name] = (ran_ns, now)
            elif now - since > LIVENESS_LIMIT_S and (polled or not _waits_its_turn(pid or 0)):
                raise Lost(f"LinuxCNC's {name} is no longer running")

    def environment(self) -> dict[str, str]:
        """Return LinuxCNC's RTAPI settings and HOME (its tool data): reading it needs them."""
        # Not rtapi_app's: it has been root, which hides its environment from an ordinary user.
        with open(f"/proc/{self._pids['milltask']}/environ", "rb") as file:
            entries = file.read().decode(errors="replace").split("\0")
        return dict(e.split("=", 1) for e in entries if e.startswith(("RTAPI_", "HOME=")))


def _status_memory() -> str | None:
    """Return the identifier and maker of NML's status memory: new after every start of LinuxCNC."""
    with open("/proc/sysvipc/shm") as file:
        for row in file:
            words = row.split()
            if words[0] == str(STATUS_KEY):
                return f"{words[1]} {words[4]}"
    return None


def _pid_of(name: str) -> int | None:
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/stat") as file:
                    start, _, end = file.read().rpartition(")")
                # A zombie of an earlier session has the same name.
                is_it = start.split("(", 1)[1] == name and end.split()[0] != "Z"
                if is_it and _shares_memory(entry):
                    return int(entry)
            except OSError:
                continue  # it ended while we looked
    return None


def _shares_memory(pid: str) -> bool:
    """Return whether a process is in our IPC namespace; another LinuxCNC may not be."""
    try:
        return os.readlink(f"/proc/{pid}/ns/ipc") == os.readlink("/proc/self/ns/ipc")
    except PermissionError:  # another user's: rtapi_app may be root's
        return True


def _run_time_ns(pid: int) -> int | None:
    """Return the processor time of all threads of a process; None where it has ended."""
    total = 0
    try:
        for thread in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{thread}/schedstat") as file:
                total += int(file.read().split()[0])
    except (OSError, ValueError):
        return None
    return total


def _waits_its_turn(pid: int) -> bool:
    """Return whether a process would run if the machine let it."""
    try:
        for thread in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{thread}/stat") as file:
                if file.read().rpartition(")")[2].split()[0] == "R":
                    return True
    except OSError:
        return False  # it has ended
    return False


class Sampler:
    """HAL's sampler: positions of every servo cycle."""

    def __init__(self, joints: int, every: int) -> None:
        self._joints, self._every = joints, every
        command = ["stdbuf", "-oL", "halsampler", "-t"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, bufsize=0)
        assert self._process.stdout is not None
        self.fd = self._process.stdout.fileno()
        self._rest = b""
        self._heard = self._start = time.monotonic()

    def close(self) -> None:
        """End the tool; by itself it would notice only with the next sample."""
        self._process.terminate()

    def read(self) -> None:
        """Pass on what has come; at the start, throw away what the buffer still held."""
        data = os.read(self.fd, 1 << 16)
        now = time.monotonic()
        if not data:
            raise Lost("HAL's sampler has ended")
        self.check(now)
        self._heard = now
        *lines, self._rest = (self._rest + data).split(b"\n")
        if now - self._start < 0.3:
            return
        rows = [self._row(line) for line in lines if self._wanted(line)]
        if rows:
            tell(samples=rows)

    def check(self, now: float) -> None:
        """Raise Lost where HAL's sampler has been silent for too long."""
        if now - self._heard > STALL_S:
            raise Lost("HAL's sampler was not read for 2 s")

    def _wanted(self, line: bytes) -> bool:
        number = line.split(b" ", 1)[0]
        if not number.isdigit():
            raise Lost(f"HAL's sampler says {line.decode(errors='replace')}")
        return int(number) % self._every == 0

    def _row(self, line: bytes) -> list[object]:
        """Return a row: number, measured, commanded, in position, wanted, image, taken."""
        words = line.split()
        if len(words) != 2 * self._joints + 5:
            raise Lost(
                f"HAL's sampler gives {len(words) - 1} values, expected {2 * self._joints + 4} "
                f"for {self._joints} joints: see the file *_omm.hal"
            )
        values = [float(word) for word in words[1:]]
        ends = 2 * self._joints
        in_position, wanted, image, taken = values[ends:]
        measured, commanded = values[0:ends:2], values[1:ends:2]
        return [int(words[0]), measured, commanded, in_position, wanted, image, taken]


class Reader:
    """The child's one loop."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._alive = Alive(("milltask", "rtapi_app"))
        os.environ.update(self._alive.environment())
        import linuxcnc

        self._linuxcnc = linuxcnc
        self._stat = linuxcnc.stat()
        try:
            self._stat.poll()
        except (linuxcnc.error, SystemError) as error:
            raise Lost(f"LinuxCNC does not answer yet ({error})") from error
        self._joints = self._stat.joints
        self._rate_hz = options.rate_hz
        self._sampler = self._make_sampler() if not options.poll else None
        self._status: dict[str, object] = {}
        self._was_running = False
        self._input = b""
        self._block: tuple[int, int] | None = None  # MDI under way: the bridge's number, LinuxCNC's
        self._errors: Any = None
        self._angle: float | None = None
        self._angle_due = 0.0
        self._image: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def run(self) -> None:
        """Read and report until LinuxCNC or the bridge ends."""
        self._hello()
        inputs = [0] + ([self._sampler.fd] if self._sampler else [])
        period = STATUS_PERIOD_S if self._sampler else 1.0 / self._rate_hz
        liveness_due = status_due = time.monotonic()
        while True:
            ready, _, _ = select.select(inputs, [], [], max(0.0, status_due - time.monotonic()))
            now = time.monotonic()
            if now >= liveness_due:
                self._alive.check(polled=self._sampler is None)
                liveness_due = now + LIVENESS_PERIOD_S
            if 0 in ready:
                self._commands()
            if self._sampler and self._sampler.fd in ready:
                self._sampler.read()
            if now >= status_due:
                status_due = max(status_due + period, now)
                self._poll()
            if self._sampler:
                self._sampler.check(now)

    def close(self) -> None:
        """End HAL's sampler."""
        if self._sampler is not None:
            self._sampler.close()

    def _hello(self) -> None:
        s = self._stat
        config = self._linuxcnc.ini(s.ini_filename)
        servo_s = float(config.find("EMCMOT", "SERVO_PERIOD") or 1e6) / 1e9
        kinematics = config.find("KINS", "KINEMATICS") or ""
        coordinates = config.find("TRAJ", "COORDINATES") or ""
        for word in kinematics.split():
            if word.lower().startswith("coordinates="):
                coordinates = word.split("=", 1)[1]
        tell(
            hello={
                "joints": self._joints,
                "letters": coordinates.replace(" ", "").upper()[: self._joints],
                "rotary": [s.joint[i]["jointType"] == 2 for i in range(self._joints)],
                "linear_units_per_mm": s.linear_units,
                "angular_units_per_degree": s.angular_units,
                "sampled": self._sampler is not None,
                "servo_s": servo_s,
                "task_s": s.cycle_time,
            }
        )

    def _make_sampler(self) -> Sampler | None:
        if self._halcmd("getp", "sampler.0.overruns") is None:
            return None
        servo_hz = 1000
        return Sampler(self._joints, max(1, round(servo_hz / self._rate_hz)))

    def _poll(self) -> None:
        s, before = self._stat, time.monotonic_ns()
        s.poll()
        if self._sampler is None:
            n = self._joints
            self._image = (float(s.dout[0]), s.aout[0], float(s.din[0]))
            measured, commanded = s.joint_actual_position[:n], s.joint_position[:n]
            tell(samples=[[before, measured, commanded, float(s.inpos), *self._image]])
        if s.din[0] and not s.dout[0]:
            self._halcmd("sets", SIGNAL_TAKEN, "FALSE")
        if self._block is not None:
            self._watch_block(*self._block)
        orient = s.spindle[0]
        running = s.interp_state != self._linuxcnc.INTERP_IDLE
        status = {
            "mode": s.task_mode,
            "interpreter": s.interp_state,
            "finished": not running and (self._was_running or bool(self._status.get("finished"))),
            "waiting": s.exec_state == self._linuxcnc.EXEC_WAITING_FOR_DELAY and bool(s.dout[0]),
            "program": s.file,
            "line": s.motion_line,
            "homed": [bool(h) for h in s.homed[: self._joints]],
            # A failed M19 is taken back at once; its fault stays until the next.
            "orientation": orient["orient_state"]
            or (self._linuxcnc.RCS_ERROR if orient["orient_fault"] else 0),
            "spindle_deg": self._spindle_deg(orient["orient_state"]),
            "g5x": [s.g5x_index, list(s.g5x_offset[:6]), s.rotation_xy],
            "g92": list(s.g92_offset[:6]),
            "gcodes": [code for code in s.gcodes[1:] if code in MODAL],
        }
        self._was_running = running
        if status != self._status:
            self._status = status
            tell(status=status)

    def _spindle_deg(self, orient_state: int) -> float | None:
        """Return where M19 holds the spindle, which only HAL knows; None where it is not held."""
        if orient_state != self._linuxcnc.RCS_DONE:
            self._angle_due = 0.0
            return None
        if time.monotonic() >= self._angle_due:  # M19 may follow M19 between two polls
            self._angle_due = time.monotonic() + ANGLE_PERIOD_S
            angle = self._halcmd("getp", "spindle.0.orient-angle")
            self._angle = float(angle) if angle else None
        return self._angle

    def _commands(self) -> None:
        data = os.read(0, 1 << 16)
        if not data:
            raise BridgeGone
        *lines, self._input = (self._input + data).split(b"\n")
        for line in lines:
            command = json.loads(line)
            error = self._obey(command)
            if error is not None:
                tell(answer={"number": command["number"], "error": error})

    def _correct(self, values: Any) -> str:
        """Set the correction that the program reads; it is not valid while it changes."""
        words = [(SIGNAL_VALID, "FALSE")]
        if values:
            words += [(name, f"{value:.6f}") for name, value in zip(SIGNALS_CORRECTION, values)]
            words += [(SIGNAL_VALID, "TRUE")]
        for name, value in words:
            if self._halcmd("sets", name, value) is None:
                if not values:
                    return ""  # nothing that could be valid
                return f"HAL has no signal {name}: see *_omm.hal"
        return ""

    def _obey(self, command: dict[str, Any]) -> str | None:
        """Carry out one command; return what went wrong, an empty text, or None: answered later."""
        if command["do"] == "acknowledge":
            done = self._halcmd("sets", SIGNAL_TAKEN, "TRUE")
            return "" if done is not None else f"HAL has no signal {SIGNAL_TAKEN}: see *_omm.hal"
        if command["do"] == "correct":
            return self._correct(command["values"] if command["valid"] else ())
        s, lc, order = self._stat, self._linuxcnc, self._linuxcnc.command()
        if s.task_state != lc.STATE_ON or not all(s.homed[: self._joints]):
            return "the machine is not switched on and referenced"
        if s.interp_state != lc.INTERP_IDLE:
            return "a program or another block runs"
        if command["do"] == "mdi":
            order.mode(lc.MODE_MDI)
            order.wait_complete(2.0)
            self._error_texts()  # what is left of earlier ones
            order.mdi(command["text"])
            self._block = int(command["number"]), order.serial
            return None
        order.mode(lc.MODE_AUTO)
        order.wait_complete(2.0)
        order.program_open(command["text"])
        order.wait_complete(2.0)
        order.auto(lc.AUTO_RUN, 0)
        return ""

    def _watch_block(self, number: int, serial: int) -> None:
        """Answer once the block that was sent is no longer being carried out."""
        s, lc = self._stat, self._linuxcnc
        if s.task_state != lc.STATE_ON:
            error = "the machine was switched off"
        elif s.state == lc.RCS_EXEC:
            return
        elif s.echo_serial_number != serial:
            error = "another command came between; whether the block was done is not known"
        elif s.state == lc.RCS_ERROR:
            error = "; ".join(self._error_texts()) or "the block failed, its screen says why"
        else:
            error = ""
        self._block = None
        tell(answer={"number": number, "error": error})

    def _error_texts(self) -> list[str]:
        """Return LinuxCNC's error messages.

        Whoever reads them first takes them; so they are read for blocks only.
        """
        if self._errors is None:
            self._errors = self._linuxcnc.error_channel()
        return [text.strip() for _, text in iter(self._errors.poll, None)]

    def _halcmd(self, *words: str) -> str | None:
        done = subprocess.run(["halcmd", *words], capture_output=True, text=True, check=False)
        return done.stdout.strip() if done.returncode == 0 else None


def main() -> None:
    """Read LinuxCNC and write lines of JSON for the bridge."""
    parser = argparse.ArgumentParser(description="Reads LinuxCNC for omm's CNC bridge.")
    parser.add_argument("--rate-hz", type=float, default=100.0)
    parser.add_argument("--poll", action="store_true", help="poll although HAL has a sampler")
    parser.add_argument("--python-path", default="/usr/lib/python3/dist-packages")
    options = parser.parse_args()
    sys.path.append(options.python_path)
    reader = None
    try:
        reader = Reader(options)
        reader.run()
    except BridgeGone:
        return
    except Lost as lost:
        tell(lost=str(lost))
    except Exception as error:
        tell(lost=f"reading LinuxCNC failed: {error!r}")
    finally:
        if reader is not None:
            reader.close()
        os._exit(0)


if __name__ == "__main__":
    main()
