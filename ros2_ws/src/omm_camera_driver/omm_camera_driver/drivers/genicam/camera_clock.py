"""When something happened by the camera's own clock, in the computer's monotonic time.

A GenICam camera stamps images by a clock of its own. It can be read (timestamp latch): the reading
was taken between the sending of the command and its acknowledgement, which bounds the difference of
the two clocks. The tightest of a few readings is kept, and its bound grows with its age, because
the clocks drift.

Where a camera cannot latch, the difference is taken from the arrivals: the smallest
`arrival − stamp` of the last images is nearest to the truth. An image may be announced at any
moment of its exposure: half of that is taken off, and added to the bound.
A camera that does not stamp at all leaves the arrival alone.

The wall clock takes no part: setting it changes nothing here.
"""

from collections import deque
from dataclasses import dataclass

DRIFT_PPM = 100
_ARRIVALS_KEPT = 200
_NO_STAMP_NS = 100_000_000  # how late an image may be of which nothing but its arrival is known
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
        Monotonic time between which that was.
    """

    camera_ns: int
    after_ns: int
    before_ns: int

    @property
    def difference_ns(self) -> int:
        """Monotonic time minus camera time, at best knowledge."""
        return (self.after_ns + self.before_ns) // 2 - self.camera_ns

    @property
    def half_width_ns(self) -> int:
        """How far off the difference may be."""
        return (self.before_ns - self.after_ns + 1) // 2

    def bound_ns(self, now_ns: int) -> int:
        """Return how far off the difference may be some time later."""
        return self.half_width_ns + abs(now_ns - self.before_ns) * DRIFT_PPM // 1_000_000


class CameraClock:
    """Turns stamps of the camera into monotonic time.

    Attributes
    ----------
    source : str
        What the last stamp was made of: `latched`, `from arrivals`, or `none`.
    problem : str
        Why the readings are not believed; empty if they are.
    unread : str
        Why the last reading could not be had; empty if it could.
    """

    def __init__(self) -> None:
        self.source = "from arrivals"
        self.problem = ""
        self.unread = ""
        self._reading: ClockReading | None = None
        self._arrivals: deque[int] = deque(maxlen=_ARRIVALS_KEPT)

    def forget(self) -> None:
        """Begin anew: nothing that is known of the difference holds any more."""
        self._reading = None
        self._arrivals.clear()

    def distrust(self) -> None:
        """Take no more readings: they are of another clock than the stamps."""
        self.forget()
        self.problem = "from arrivals (the camera's clock reads other than it stamps)"

    def can_be(self, camera_ns: int, arrival_ns: int, exposure_ns: int) -> bool:
        """Return whether an image with this stamp can have arrived when it did."""
        if self._reading is None or not camera_ns:
            return True
        begin_ns = camera_ns + self._reading.difference_ns
        bound_ns = self._reading.bound_ns(begin_ns)
        return -bound_ns - _EARLY_NS <= arrival_ns - begin_ns <= exposure_ns + _LATE_NS

    def add_reading(self, reading: ClockReading) -> None:
        """Take in a reading.

        It is kept if it is tighter than the last one has become, or contradicts it: then the
        camera's clock was set in between (by PTP).
        """
        if self.problem:
            return
        self.unread = ""
        if self._reading is not None:
            bound_ns = self._reading.bound_ns(reading.before_ns)
            apart_ns = abs(reading.difference_ns - self._reading.difference_ns)
            if reading.half_width_ns > bound_ns and apart_ns <= bound_ns + reading.half_width_ns:
                return
        self._reading = reading
        self.source = "latched"

    def told(self) -> str:
        """Return how stamps come about, and why so, for the diagnostics."""
        if self.problem:
            return self.problem
        return f"{self.source} ({self.unread})" if self.unread else self.source

    def add_arrival(self, camera_ns: int, arrival_ns: int) -> None:
        """Take in when the first data of an image arrived."""
        self._arrivals.append(arrival_ns - camera_ns)

    def exposure_begin(self, camera_ns: int, arrival_ns: int, exposure_ns: int) -> tuple[int, int]:
        """Return the monotonic time of a stamp, and how far off it may be (both ns).

        Parameters
        ----------
        camera_ns : the stamp, of the begin of the exposure; 0: the camera gave none
        arrival_ns : monotonic time at which the image arrived
        exposure_ns : duration of the exposure
        """
        if not camera_ns:
            self.source = "none"
            return arrival_ns - exposure_ns, exposure_ns + _NO_STAMP_NS
        if self._reading is not None:
            begin_ns = camera_ns + self._reading.difference_ns
            self.source = "latched"
            return begin_ns, self._reading.bound_ns(begin_ns)
        self.source = "from arrivals"
        self.add_arrival(camera_ns, arrival_ns)
        smallest_ns, largest_ns = min(self._arrivals), max(self._arrivals)
        spread_ns = max(largest_ns - smallest_ns, 1_000_000)
        half_ns = exposure_ns // 2
        return camera_ns + smallest_ns - half_ns, spread_ns + half_ns
