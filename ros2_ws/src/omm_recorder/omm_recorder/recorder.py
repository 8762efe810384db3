"""Takes messages as fast as they come and writes them in a thread of its own.

Nothing of ROS is in here: the node feeds it. It falls behind only when the disk or the processor
does; then messages are refused as a whole, counted and told at once.
"""

import os
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from omm_core.errors import OmmError
from omm_core.words import NOTHING, Words, keyed, of_error, verbatim
from omm_recorder.counting import TopicTally
from omm_recorder.recording_state import Limits, RecordingState, available_memory
from omm_recording.writing import RecordingWriter, TopicToRecord

FLUSH_PERIOD_S = 0.25
WRITING_NICENESS = 10
WATCH_PERIOD_S = 1.0
STOPPED = "stopped"

Work = Callable[[RecordingWriter], None]


class Recorder:
    """Records into one folder until `stop`.

    Parameters
    ----------
    writer
        The recording. It belongs to the recorder's thread from now on.
    limits
        When to warn and when to stop.
    tell
        Called with what people must know at once.
    """

    def __init__(
        self, writer: RecordingWriter, limits: Limits, tell: Callable[[str], None]
    ) -> None:
        self._writer = writer
        self._limits = limits
        self._tell = tell
        self._tallies: dict[str, TopicTally] = {}
        self._condition = threading.Condition()
        self._queue: deque[tuple[int, Work]] = deque()
        self._queue_bytes = 0
        self._queue_peak_bytes = 0
        self._queue_limit_bytes = min(limits.queue_bytes, available_memory() // 4)
        self._stopping = False
        self._ended: str | None = None
        self._trouble = NOTHING
        self._told_loss_s = -10.0
        self._started_ns = time.time_ns()
        self._free_bytes = self._free()
        self._left_s = float("inf")
        self._rate = 0.0
        self._file: Path | None = None
        self._failure: OmmError | None = None
        self._thread = threading.Thread(target=self._run, name="recorder")
        self._thread.start()

    def add_topic(self, topic: TopicToRecord, *, shared: bool = False) -> None:
        """Announce a topic before its first message; `shared` by several publishers."""
        self._tallies[topic.name] = TopicTally(missing=None if shared else 0)
        self._enqueue(0, lambda writer: writer.add_topic(topic))

    def add_file(self, name: str, data: bytes, mode: int = 0o666) -> None:
        """Put a file into the recording, which nobody may read then who may not read the file."""

        def add(writer: RecordingWriter) -> None:
            writer.keep_as_private_as(mode)
            writer.add_file(name, data, time.time_ns())

        self._enqueue(len(data), add)

    def add_table(self, name: str, values: Mapping[str, str]) -> None:
        """Put a named table into the recording."""
        self._enqueue(0, lambda writer: writer.add_table(name, dict(values)))

    def put(
        self, topic: str, data: bytes | memoryview, sequence: int, log_ns: int, publish_ns: int
    ) -> bool:
        """Take a message; False where it had to be refused."""
        if self._stopping:  # it came after the end, which is no loss
            return False
        tally = self._tallies[topic]
        # A middleware that does not number messages gives 0: then none can be missed.
        gap = tally.see(sequence or tally.received + 1, log_ns)
        if gap:
            self._tell_loss(f"{gap} messages on {topic} never arrived here")
        write = partial(_write, topic=topic, data=data, ids=(sequence, log_ns, publish_ns))
        if self._enqueue(len(data), write):
            return True
        tally.lost += 1
        reason = "recording has ended" if self._ended is not None else "the disk does not keep up"
        self._tell_loss(f"a message on {topic} is lost: {reason}")
        return False

    def announce(self, topic: str, published: int) -> None:
        """Take how many messages the publisher of a topic says it has published."""
        if topic in self._tallies:
            self._tallies[topic].announce(published, time.monotonic())

    def waiting_for(self, since_s: float) -> list[str]:
        """Return the topics whose last messages may still be missing (now in monotonic s)."""
        return [
            name
            for name, tally in self._tallies.items()
            if tally.missing is not None
            and (tally.received or tally.announced)
            and not tally.answered(since_s)
        ]

    def count_ends(self, since_s: float) -> list[str]:
        """Count what is missing at the end of topics; return those of which it is not known."""
        for name, tally in self._tallies.items():
            tally.end(since_s)
            if tally.missing_at_end:
                self._tell_loss(f"the last {tally.missing_at_end} messages on {name} never arrived")
        return [
            name
            for name, tally in self._tallies.items()
            if tally.missing is not None and tally.received and tally.missing_at_end is None
        ]

    def state(self) -> RecordingState:
        """Return how the recording is going."""
        tallies = list(self._tallies.values())
        return RecordingState(
            recording=self._ended is None,
            ended_because=self._ended or "",
            trouble=self._trouble,
            bytes_written=self._writer.bytes_written,
            queue_bytes=self._queue_bytes,
            free_bytes=self._free_bytes,
            left_s=self._left_s,
            bytes_per_s=self._rate,
            received=sum(t.received for t in tallies),
            lost=sum(t.lost for t in tallies),
            missing=sum(t.missing or 0 for t in tallies),
        )

    def stop(self) -> Path:
        """Write what waits, end the recording and return it.

        Raises
        ------
        OmmError
            If it could not be ended.
        """
        with self._condition:
            self._stopping = True
            self._condition.notify()
        self._thread.join()
        if self._failure is not None:
            raise self._failure
        assert self._file is not None
        return self._file

    def _enqueue(self, size: int, work: Work) -> bool:
        with self._condition:
            full = size and self._queue_bytes + size > self._queue_limit_bytes and self._queue
            if full or self._stopping or self._ended is not None:
                return False
            self._queue.append((size, work))
            self._queue_bytes += size
            self._queue_peak_bytes = max(self._queue_peak_bytes, self._queue_bytes)
            self._condition.notify()
        return True

    def _next(self, timeout_s: float) -> tuple[int, Work] | None:
        with self._condition:
            if not self._queue and not self._stopping:
                self._condition.wait(timeout_s)
            return self._queue[0] if self._queue else None

    def _done(self, size: int) -> None:
        with self._condition:
            self._queue.popleft()
            self._queue_bytes -= size

    def _run(self) -> None:
        # Messages wait in the queue; what must be in time on this machine goes first. On Linux
        # this is of the thread, not of the process.
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), WRITING_NICENESS)
        reason = STOPPED
        try:
            reason = self._write_until_stopped()
        except OSError as error:
            reason = f"{error.strerror} while writing {self._writer.unfinished}"
            self._tell_end(reason)
        except Exception as error:  # a thread that dies unseen would go on saying that all is well
            traceback.print_exc()
            reason = f"{type(error).__name__} while writing: {error}"
            self._tell_end(reason)
        self._end(reason)

    def _tell_end(self, reason: str) -> None:
        self._trouble = _has_ended(verbatim(reason))
        self._tell(f"{self._trouble}. What was written until now is kept.")

    def _write_until_stopped(self) -> str:
        flushed_s = watched_s = time.monotonic()
        written = self._writer.bytes_written
        while True:
            item = self._next(FLUSH_PERIOD_S)
            if item is not None:
                size, work = item
                work(self._writer)
                self._done(size)
            elif self._stopping:
                return STOPPED
            now_s = time.monotonic()
            if now_s - flushed_s >= FLUSH_PERIOD_S:
                self._writer.flush()
                flushed_s = now_s
            if now_s - watched_s >= WATCH_PERIOD_S:
                rate = (self._writer.bytes_written - written) / (now_s - watched_s)
                written, watched_s = self._writer.bytes_written, now_s
                if not self._watch(rate):
                    return "the disk is full"

    def _watch(self, rate: float) -> bool:
        """Look at the disk; False where it is time to stop."""
        # Smoothed over some ten seconds: images come in bursts.
        self._rate += 0.1 * (rate - self._rate) if self._rate else rate
        if self._writer.folder_gone:
            if "removed" not in self._trouble:
                self._trouble = keyed(
                    "said.recording_removed",
                    "{file} was removed while it is being written; it will be made again when the"
                    " recording ends. Do not stop this by force",
                    file=verbatim(str(self._writer.unfinished)),
                )
                self._tell(self._trouble)
            return True
        self._free_bytes = self._free()
        usable = max(0, self._free_bytes - self._limits.stop_free_bytes)
        self._left_s = usable / self._rate if self._rate > 0 else float("inf")
        if usable == 0:
            self._trouble = _has_ended(
                keyed(
                    "said.disk_full",
                    "{mb} MB are left on the disk of {folder}",
                    mb=self._free_bytes >> 20,
                    folder=verbatim(str(self._writer.path.parent)),
                )
            )
            self._tell(f"{self._trouble}. What was written until now is kept.")
            return False
        self._warn_of_space()
        return True

    def _warn_of_space(self) -> None:
        near = self._left_s < self._limits.warn_left_s
        if near and "left on" not in self._trouble:
            self._tell(f"{self._space()}: make space or stop soon.")
        if near:
            self._trouble = self._space()
        elif "left on" in self._trouble:
            self._trouble = NOTHING

    def _space(self) -> Words:
        return keyed(
            "said.disk_near_full",
            "{gb} GB, {minutes} minutes, are left on the disk of {folder}",
            gb=f"{self._free_bytes / 1e9:.1f}",
            minutes=f"{self._left_s / 60:.1f}",
            folder=verbatim(str(self._writer.path.parent)),
        )

    def _end(self, reason: str) -> None:
        with self._condition:
            self._ended = reason
            self._queue.clear()
            self._queue_bytes = 0
        self._flush_before_counting()
        counts = self._writer.counts()
        report = {name: t.as_text(counts.get(name, 0)) for name, t in self._tallies.items()}
        report["started_ns"] = str(self._started_ns)
        report["ended_ns"] = str(time.time_ns())
        report["ended_because"] = reason
        report["queue_peak_bytes"] = str(self._queue_peak_bytes)
        try:
            self._file = self._writer.close(report)
        except OmmError as error:
            self._failure = error
            self._trouble = of_error(error)
            self._tell(str(error))
        except Exception as error:
            traceback.print_exc()
            text = f"The recording could not be closed: {type(error).__name__}: {error}."
            self._failure = OmmError(text)
            self._trouble = verbatim(text)
            self._tell(text)

    def _flush_before_counting(self) -> None:
        try:
            self._writer.flush_at_end()
        except OSError as error:  # told by `close`, which will meet it again
            self._trouble = self._trouble or of_error(error)

    def _free(self) -> int:
        status = os.fstatvfs(self._writer.fileno())
        return status.f_bavail * status.f_frsize

    def _tell_loss(self, text: str) -> None:
        """Report a loss, at once and then at most once a second."""
        now_s = time.monotonic()
        if now_s - self._told_loss_s < 1.0:
            return
        self._told_loss_s = now_s
        state = self.state()
        total = f"{state.lost} lost here and {state.missing} on the way so far"
        self._tell(f"Recording is incomplete: {text} ({total}).")


def _write(
    writer: RecordingWriter,
    *,
    topic: str,
    data: bytes | memoryview,
    ids: tuple[int, int, int],
) -> None:
    sequence, log_ns, publish_ns = ids
    writer.write(topic, sequence, log_ns, publish_ns, data)


def _has_ended(why: Words) -> Words:
    return keyed("said.recording_ended", "Recording has ended: {why}", why=why)
