"""Inputs that nobody meant: mutations of sound files, and a command run on them in its limits.

Used by the tests (a few, fixed seeds) and by `bench/hostile.py` (as many as are asked for).
"""

from __future__ import annotations

import contextlib
import io
import resource
import signal
import struct
import traceback
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

LIMIT_S = 10
LIMIT_BYTES = 1 << 30
_INTERESTING = (0, 1, 2, 3, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 2**63 - 1, 2**64 - 1)
_WORDS = (
    b"nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"9" * 5000, b"1,5", b"1:30", b"010", b"\x00",
    b"\xff\xfe", b"null", b"true", b"[]", b"{}", b"[[[[", b"{a: ", b"&a [*a]", b"*a", b"!!int x",
    "é\u202e\U0001f600".encode(), b"../../etc/passwd", b"/dev/zero", b"\x1b[2J", b"'", b'"', b"\n",
    b"\t", b": ", b"- ", b"#", b",", b"<a>", b"&x;", b"$(id)", b"${x}", b"10000000000000000000000",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a command did with an input.

    Attributes
    ----------
    status : int or None
        Its exit status; None where it ended in an exception of Python.
    words : str
        What it said on stderr, or the traceback.
    took_s, peak_bytes : float, int
        How long it took, and by how much the process grew.
    """

    status: int | None
    words: str
    took_s: float
    peak_bytes: int

    def fault(self) -> str:
        """Say what is wrong with it; empty where nothing is."""
        if self.status is None:
            return f"traceback: {self.words[-2000:]}"
        if self.status not in (0, 1, 2):
            return f"status {self.status}: {self.words[-500:]}"
        if self.status and not self.words.strip():
            return f"status {self.status} without a word"
        if "Traceback" in self.words:
            return f"a traceback in its words: {self.words[-2000:]}"
        if self.peak_bytes > LIMIT_BYTES:
            return f"{self.peak_bytes / 1e9:.1f} GB"
        return f"{self.took_s:.1f} s" if self.took_s > LIMIT_S else ""


class TooLong(BaseException):
    """The time is up; no `except Exception` holds it."""


@contextlib.contextmanager
def within_limits() -> Iterator[None]:
    """Stop what takes more than twice the time that a command may take."""

    def stop(_: int, __: Any) -> None:
        raise TooLong

    # Time of the processor, since the machine may have others to serve; and a long time in all,
    # for what waits for ever.
    before = [(n, signal.signal(n, stop)) for n in (signal.SIGPROF, signal.SIGALRM)]
    signal.setitimer(signal.ITIMER_PROF, 2 * LIMIT_S)
    signal.alarm(30 * LIMIT_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0)
        for number, handler in before:
            signal.signal(number, handler)


def run_command(words: list[str]) -> Outcome:
    """Run one command of `./omm` in this process."""
    from omm_bringup.command_line import main

    return observed(lambda: main(words))


def observed(work: Callable[[], int]) -> Outcome:
    """Run something that returns a status, and see what it did."""
    out, errors = io.StringIO(), io.StringIO()
    usage = resource.getrusage(resource.RUSAGE_SELF)
    before, started_s = usage.ru_maxrss, usage.ru_utime + usage.ru_stime
    status: int | None
    try:
        with within_limits(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
            status = work()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 2
    except TooLong:
        status, errors = None, io.StringIO("took too long\n" + traceback.format_exc())
    except BaseException:
        status, errors = None, io.StringIO(traceback.format_exc())
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return Outcome(
        status=status,
        words=errors.getvalue(),
        # Of the processor: the machine may have others to serve.
        took_s=usage.ru_utime + usage.ru_stime - started_s,
        peak_bytes=max(0, usage.ru_maxrss - before) << 10,
    )


def mutated(data: bytes, random: np.random.Generator, *, text: bool = False) -> bytes:
    """Return data with one to four changes of any kind."""
    changed = bytearray(data)
    kinds = _TEXT if text else _BINARY
    for _ in range(int(random.integers(1, 5))):
        if not changed:
            break
        kinds[int(random.integers(len(kinds)))](changed, random)
    return bytes(changed)


def _at(data: bytearray, random: np.random.Generator) -> int:
    return int(random.integers(len(data)))


def _flip(data: bytearray, random: np.random.Generator) -> None:
    data[_at(data, random)] ^= 1 << int(random.integers(8))


def _set(data: bytearray, random: np.random.Generator) -> None:
    data[_at(data, random)] = int(random.integers(256))


def _cut(data: bytearray, random: np.random.Generator) -> None:
    at = _at(data, random)
    del data[at : at + int(random.integers(1, 64))]


def _cut_end(data: bytearray, random: np.random.Generator) -> None:
    del data[_at(data, random) :]


def _double(data: bytearray, random: np.random.Generator) -> None:
    at = _at(data, random)
    data[at:at] = data[at : at + int(random.integers(1, 200))]


def _number(data: bytearray, random: np.random.Generator) -> None:
    at, size = _at(data, random), int(random.choice([1, 2, 4, 8]))
    value = _INTERESTING[int(random.integers(len(_INTERESTING)))] & (256**size - 1)
    data[at : at + size] = value.to_bytes(size, "little")[: max(0, len(data) - at)]


def _zero(data: bytearray, random: np.random.Generator) -> None:
    at = _at(data, random)
    end = min(len(data), at + int(random.integers(1, 512)))
    data[at:end] = bytes(end - at)


def _word(data: bytearray, random: np.random.Generator) -> None:
    at = _at(data, random)
    data[at : at + int(random.integers(0, 12))] = _WORDS[int(random.integers(len(_WORDS)))]


def _value(data: bytearray, random: np.random.Generator) -> None:
    """Put something else in the place of one value of a text."""
    import re

    spans = [m.span() for m in re.finditer(rb"[-+.\w]+", data)]
    if spans:
        start, end = spans[int(random.integers(len(spans)))]
        data[start:end] = _WORDS[int(random.integers(len(_WORDS)))]


def _line(data: bytearray, random: np.random.Generator) -> None:
    """Take a line away, or put it elsewhere."""
    lines = bytes(data).splitlines(keepends=True)
    taken = lines.pop(int(random.integers(len(lines))))
    if random.integers(2):
        lines.insert(int(random.integers(len(lines) + 1)), taken)
    data[:] = b"".join(lines)


_BINARY = (_flip, _flip, _set, _cut, _cut_end, _double, _number, _number, _zero, _word)
_TEXT = (_flip, _cut, _cut_end, _double, _word, _value, _value, _value, _line)


def recording_with_sound_sums(data: bytes) -> bytes:
    """Make the footer's checksum of a changed recording hold again, as its forger would."""
    end = len(data) - 8 - 29
    if end < 8 or data[end] != 0x02:
        return data
    start = struct.unpack_from("<Q", data, end + 9)[0]
    if not 8 <= start <= end:
        return data
    crc = zlib.crc32(data[start : end + 25])
    return data[: end + 25] + struct.pack("<I", crc) + data[end + 29 :]
