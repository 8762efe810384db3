r"""From the control's clock to ours.

Only one thing is seen of a control's clock: a sample that it stamped :math:`c` arrived when our
clock showed :math:`r`. The delay :math:`r - c` is offset + drift · c + a transport delay that is
never below its least value. The line that touches the delays **from below** is therefore the
clock relation; late samples, however many, do not move it. Of all such lines the one through the
edge of the lower convex hull above the middle of the window has the least total distance to the
delays (Moon, Skelly, Towsley: "Estimation and removal of clock skew from network delay
measurements", INFOCOM 1999).

The least delay itself cannot be seen in one direction; it is a parameter, and belongs to the
uncertainty.
"""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

_Point = tuple[int, int]  # control's stamp, delay r - c; both ns


@dataclass(frozen=True, kw_only=True)
class ClockRelation:
    """``our time = control time + offset_ns + drift · (control time − reference_ns)``."""

    reference_ns: int
    offset_ns: float
    drift: float
    uncertainty_ns: float
    """Standard deviation of our time of a control's stamp within the window."""
    drift_uncertainty: float
    """Of ``drift``, s/s; grows the uncertainty outside of the window."""

    def ours_ns(self, control_ns: int) -> int:
        """Return a moment of the control's clock (ns) on ours."""
        age_ns = control_ns - self.reference_ns
        return control_ns + round(self.offset_ns + self.drift * age_ns)


class ControlClock:
    """Learns the relation of a control's clock to ours, and notices when the control's jumps."""

    def __init__(
        self,
        *,
        window_ns: int = 30_000_000_000,
        bucket_ns: int = 250_000_000,
        least_delay_ns: int = 0,
        least_delay_uncertainty_ns: int = 200_000,
        start_uncertainty_ns: int = 20_000_000,
        largest_drift: float = 500e-6,
    ) -> None:
        self._bucket_ns = bucket_ns
        self._least_delay_ns = least_delay_ns
        self._floor_ns = least_delay_uncertainty_ns
        self._start_ns = start_uncertainty_ns
        self._largest_drift = largest_drift
        self._least: deque[_Point] = deque(maxlen=max(4, window_ns // bucket_ns))
        self._last_ns: int | None = None
        self._relation: ClockRelation | None = None
        self.jumps = 0
        """How often the control's clock has jumped."""

    @property
    def relation(self) -> ClockRelation | None:
        """The relation of the clocks as known so far; None before the first sample."""
        return self._relation

    def observe(self, control_ns: int, received_ns: int) -> tuple[int, int]:
        """Learn from one sample, and map its stamp.

        Parameters
        ----------
        control_ns, received_ns : int
            The control's stamp, and our monotonic clock when the sample arrived.

        Returns
        -------
        ours_ns, uncertainty_ns : int
            Our clock when the sample was true, and its standard deviation.
        """
        delay_ns = received_ns - control_ns
        if self._jumped(control_ns, delay_ns):
            self.jumps += 1
            self._least.clear()
            self._relation = None
        self._last_ns = control_ns
        bucket = control_ns // self._bucket_ns
        if not self._least or bucket != self._least[-1][0] // self._bucket_ns:
            self._least.append((control_ns, delay_ns))
            self._relation = self._fit()
        elif delay_ns < self._least[-1][1]:
            self._least[-1] = (control_ns, delay_ns)
            self._relation = self._fit()
        assert self._relation is not None
        return self._relation.ours_ns(control_ns), round(self._relation.uncertainty_ns)

    def _jumped(self, control_ns: int, delay_ns: int) -> bool:
        """Return whether this sample contradicts the relation.

        It does when it was made after it came, or before the last one.

        A sample that is merely late contradicts nothing.
        """
        if self._relation is None or self._last_ns is None:
            return False
        known_ns = self._relation.ours_ns(control_ns) - control_ns + self._least_delay_ns
        early_ns = known_ns - delay_ns
        allowed_ns = 5 * self._relation.uncertainty_ns + 1e6
        allowed_ns += self._relation.drift_uncertainty * abs(control_ns - self._last_ns)
        return early_ns > allowed_ns or control_ns < self._last_ns

    def _fit(self) -> ClockRelation:
        points = list(self._least)
        first, last = points[0][0], points[-1][0]
        span_ns = last - first
        if len(points) < 8:  # too short to tell drift from delay
            least = min(delay for _, delay in points)
            return ClockRelation(
                reference_ns=last,
                offset_ns=least - self._least_delay_ns,
                drift=0.0,
                uncertainty_ns=self._start_ns / (1 + len(points)),
                drift_uncertainty=self._largest_drift,
            )
        (c0, d0), (c1, d1) = _edge_over(_lower_hull(points), (first + last) // 2)
        drift = (d1 - d0) / (c1 - c0)
        drift = max(-self._largest_drift, min(self._largest_drift, drift))
        spread_ns = sorted(d - d0 - drift * (c - c0) for c, d in points)[len(points) // 2]
        return ClockRelation(
            reference_ns=c0,
            offset_ns=d0 - self._least_delay_ns,
            drift=drift,
            uncertainty_ns=math.hypot(self._floor_ns, spread_ns),
            drift_uncertainty=spread_ns / span_ns,
        )


def _lower_hull(points: list[_Point]) -> list[_Point]:
    """Return the lower convex hull of points ordered by stamp (Andrew's monotone chain)."""
    hull: list[_Point] = []
    for c, d in points:
        while len(hull) >= 2:
            (c0, d0), (c1, d1) = hull[-2], hull[-1]
            if (c1 - c0) * (d - d0) > (d1 - d0) * (c - c0):
                break
            hull.pop()
        hull.append((c, d))
    return hull


def _edge_over(hull: list[_Point], middle_ns: int) -> tuple[_Point, _Point]:
    return next((edge for edge in pairwise(hull) if edge[1][0] >= middle_ns), (hull[-2], hull[-1]))


def ros_from_monotonic_ns(monotonic_ns: int) -> int:
    """Return the ROS (system) time of a moment of the monotonic clock.

    It holds also after the system time is set.
    """
    return monotonic_ns + time.time_ns() - time.monotonic_ns()
