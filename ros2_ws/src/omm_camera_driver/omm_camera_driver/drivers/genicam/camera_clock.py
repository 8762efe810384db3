"""When something happened by the camera's own clock, in system time.

A GigE or USB3 Vision camera stamps images by a clock of its own. The protocol lets it be read
(timestamp latch): the reading was taken between the sending of the command and its acknowledgement,
which bounds the difference of the two clocks. The tightest of a few readings is kept, and its bound
grows with its age, because the clocks drift.

Where a camera cannot latch, the difference is taken from the arrivals: no image arrives before it
was taken, so the smallest `arrival − stamp` of the last images is nearest to the truth.
"""

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

DRIFT_PPM = 100
_ARRIVALS_KEPT = 200
_SET_NS = 1_000_000
# An image is stamped before it arrives, and not long before the end of its exposure.
_EARLY_NS, _LATE_NS = 5_000_000, 10_000_000_000


@dataclass(frozen=True, kw_only=True)
class ClockReading:
    """One reading of the camera's clock.

    Attributes
    ----------
    camera_ns : int
        What the camera's clock said.
    after_ns, before_ns : int
        System time between which that was.
    """

    camera_ns: int
    after_ns: int
    before_ns: int

    @property
    def difference_ns(self) -> int:
        """System time minus camera time, at best knowledge."""
        return (self.after_ns + self.before_ns) // 2 - self.camera_ns

    @property
    def half_width_ns(self) -> int:
        """How far off the difference may be."""
        return (self.before_ns - self.after_ns + 1) // 2

    def bound_ns(self, now_ns: int) -> int:
        """Return how far off the difference may be some time later."""
        return self.half_width_ns + abs(now_ns - self.before_ns) * DRIFT_PPM // 1_000_000


class Period:
    """The system time between which something was done."""

    def __init__(self) -> None:
        self.after_ns, self._began_ns = time.time_ns(), time.monotonic_ns()
        self.before_ns, self._ended_ns = self.after_ns, self._began_ns

    def end(self) -> None:
        """Take note that it is done."""
        self.before_ns, self._ended_ns = time.time_ns(), time.monotonic_ns()

    def reading(self, camera_ns: int) -> ClockReading | None:
        """Return the reading of a camera's clock; None where the system's was set meanwhile."""
        lasted_ns = self.before_ns - self.after_ns
        if abs(lasted_ns - (self._ended_ns - self._began_ns)) > _SET_NS:
            return None
        return ClockReading(camera_ns=camera_ns, after_ns=self.after_ns, before_ns=self.before_ns)


@contextmanager
def timed() -> Iterator[Period]:
    """Note the system time before and after what is done within."""
    period = Period()
    yield period
    period.end()


class CameraClock:
    """Turns stamps of the camera into system time."""

    def __init__(self) -> None:
        self._reading: ClockReading | None = None
        self._arrivals: deque[int] = deque(maxlen=_ARRIVALS_KEPT)

    @property
    def is_read(self) -> bool:
        """Whether there is a reading, so that the arrivals need not do."""
        return self._reading is not None

    def add_reading(self, reading: ClockReading) -> None:
        """Take in a reading.

        It is kept if it is tighter than the last one has become, or contradicts it: then one of the
        clocks was set in between.
        """
        if self._reading is not None:
            bound_ns = self._reading.bound_ns(reading.before_ns)
            apart_ns = abs(reading.difference_ns - self._reading.difference_ns)
            if reading.half_width_ns > bound_ns and apart_ns <= bound_ns + reading.half_width_ns:
                return
        self._reading = reading

    def can_be(self, camera_ns: int, arrival_ns: int, exposure_ns: int) -> bool:
        """Return whether an image with this stamp can have arrived when it did."""
        if self._reading is None:
            return True
        system_ns, bound_ns = self.system_time(camera_ns, arrival_ns)
        return -bound_ns - _EARLY_NS <= arrival_ns - system_ns <= exposure_ns + _LATE_NS

    def add_arrival(self, camera_ns: int, arrival_ns: int) -> None:
        """Take in when the first data of an image arrived."""
        self._arrivals.append(arrival_ns - camera_ns)

    def system_time(self, camera_ns: int, latest_ns: int) -> tuple[int, int]:
        """Return the system time of a stamp, and how far off it may be (both ns).

        Parameters
        ----------
        camera_ns : the stamp
        latest_ns : system time at which the stamp was known, a bound from above
        """
        if self._reading is not None:
            difference_ns = self._reading.difference_ns
            system_ns = camera_ns + difference_ns
            return system_ns, self._reading.bound_ns(system_ns)
        if not self._arrivals:
            return latest_ns, latest_ns
        smallest_ns, largest_ns = min(self._arrivals), max(self._arrivals)
        return camera_ns + smallest_ns, max(largest_ns - smallest_ns, 1_000_000)
