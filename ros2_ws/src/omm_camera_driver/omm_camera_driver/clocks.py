"""The system's two clocks: the wall clock, which stamps, and the monotonic one, which measures.

The wall clock may be set at any moment (NTP's first answer, an operator, the end of a sleep).
Durations and schedules are therefore taken from the monotonic clock, and a time of it becomes a
stamp at the last moment. Linux slews both clocks alike, so that their difference changes in no
other way than by a step: that is how one is noticed.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

_TRIES, _TIGHT_NS = 20, 2_000
_SMALLEST_STEP_NS = 1_000_000
_SHORTEST_SLEEP_NS = 100_000_000


@dataclass(frozen=True, kw_only=True)
class Clocks:
    """One look at all clocks.

    Attributes
    ----------
    monotonic_ns, system_ns : int
        Monotonic clock and wall clock (ns since the epoch).
    since_boot_ns : int
        Monotonic clock that goes on while the computer sleeps.
    half_width_ns : int
        How far apart the looks may have been.
    """

    monotonic_ns: int
    system_ns: int
    since_boot_ns: int
    half_width_ns: int = 0

    @property
    def offset_ns(self) -> int:
        """Wall clock minus monotonic clock."""
        return self.system_ns - self.monotonic_ns


@dataclass(frozen=True, kw_only=True)
class Step:
    """The wall clock was set, or the computer slept.

    Attributes
    ----------
    step_ns : int
        By how much the wall clock went forward against the monotonic one.
    slept_ns : int
        How much of that the computer slept.
    """

    step_ns: int
    slept_ns: int

    def __str__(self) -> str:
        told = []
        if self.slept_ns:
            told.append(f"The computer slept for {self.slept_ns / 1e9:.1f} s.")
        set_ns = self.step_ns - self.slept_ns
        if abs(set_ns) >= _SMALLEST_STEP_NS:
            told.append(
                f"The system's clock was set by {set_ns / 1e9:+.3f} s. Let NTP or PTP settle "
                "before measuring."
            )
        return f"{' '.join(told)} An image of that moment is not used."


def read_clocks() -> Clocks:
    """Look at all clocks, until a look was not interrupted; else the one that took the shortest."""
    looks: list[Clocks] = []
    for _ in range(_TRIES):
        before_ns = time.monotonic_ns()
        system_ns, boot_ns = time.time_ns(), time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        after_ns = time.monotonic_ns()
        looks.append(
            Clocks(
                monotonic_ns=(before_ns + after_ns) // 2,
                system_ns=system_ns,
                since_boot_ns=boot_ns,
                half_width_ns=(after_ns - before_ns + 1) // 2,
            )
        )
        if looks[-1].half_width_ns <= _TIGHT_NS:
            break
    return min(looks, key=lambda look: look.half_width_ns)


class WallClock:
    """Turns times of the monotonic clock into system time, and notices when that was set.

    Parameters
    ----------
    read : looks at the clocks
    """

    def __init__(self, read: Callable[[], Clocks] = read_clocks) -> None:
        self._read = read
        self._last = read()
        self._offset_ns, self._unsure_ns = self._last.offset_ns, self._last.half_width_ns

    @property
    def unsure_ns(self) -> int:
        """How far off a conversion may be."""
        return self._unsure_ns

    def monotonic_ns(self) -> int:
        """Return the monotonic clock's time."""
        return self._read().monotonic_ns

    def look(self) -> Step | None:
        """Look at the clocks; return by how much the wall clock was set since the last look."""
        last, self._last = self._last, self._read()
        step_ns = self._last.offset_ns - self._offset_ns
        unsure_ns = self._unsure_ns + self._last.half_width_ns
        if abs(step_ns) <= unsure_ns and 2 * self._last.half_width_ns >= self._unsure_ns:
            return None  # the same: stamps shall not tremble with each look
        self._offset_ns, self._unsure_ns = self._last.offset_ns, self._last.half_width_ns
        if abs(step_ns) <= _SMALLEST_STEP_NS + unsure_ns:
            return None
        awake_ns = self._last.monotonic_ns - last.monotonic_ns
        slept_ns = self._last.since_boot_ns - last.since_boot_ns - awake_ns
        return Step(step_ns=step_ns, slept_ns=slept_ns if slept_ns > _SHORTEST_SLEEP_NS else 0)

    def system_ns(self, monotonic_ns: int) -> int:
        """Return the system time of a time of the monotonic clock, by the last look."""
        return monotonic_ns + self._offset_ns

    def monotonic_of(self, system_ns: int) -> int:
        """Return the monotonic clock's time of a system time, by the last look."""
        return system_ns - self._offset_ns
