"""Where the simulated spindle truly was: what the simulated cameras take their images from."""

import threading
from bisect import bisect_left
from collections import deque

import numpy as np

from omm_camera_driver.driver import FrameLost
from omm_core.geometry import RigidTransform

_LONGEST_GAP_NS = 100_000_000
_KEPT = 2000


class TruePoses:
    """Poses as they come in, asked for at any time in between; safe between threads."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, RigidTransform]] = deque(maxlen=_KEPT)
        self._news = threading.Condition()

    def add(self, stamp_ns: int, machine_T_spindle: RigidTransform) -> None:
        """Take in a pose; one that is not later than the last one starts a new history."""
        with self._news:
            if self._poses and stamp_ns <= self._poses[-1][0]:
                self._poses.clear()
            self._poses.append((stamp_ns, machine_T_spindle))
            self._news.notify_all()

    def at(self, stamp_ns: int, timeout_s: float) -> RigidTransform:
        """The pose at a time, waited for where it has not come in yet.

        Raises
        ------
        FrameLost
            There is none: no poses come, or there is a gap around that time.
        """
        with self._news:
            self._news.wait_for(
                lambda: self._poses and self._poses[-1][0] >= stamp_ns, timeout=timeout_s
            )
            poses = list(self._poses)
        if not poses:
            raise FrameLost(
                "Expected true poses of the spindle on /simulation/true_spindle_pose, got none. "
                "Is the bridge to a simulated control running?"
            )
        after = bisect_left(poses, stamp_ns, key=lambda pose: pose[0])
        if after == 0 and poses[0][0] == stamp_ns:
            return poses[0][1]
        if after in (0, len(poses)):
            late_ms = (stamp_ns - poses[-1][0]) / 1e6
            raise FrameLost(
                "Expected true poses of the spindle before and after the exposure, got the last "
                f"{late_ms:.0f} ms before it. Is the simulated control still running?"
            )
        (stamp_a, a), (stamp_b, b) = poses[after - 1], poses[after]
        if stamp_b - stamp_a > _LONGEST_GAP_NS:
            raise FrameLost(
                "Expected true poses of the spindle around the exposure at least every "
                f"{_LONGEST_GAP_NS // 1_000_000} ms, got a gap of {(stamp_b - stamp_a) / 1e6:.0f}."
            )
        return interpolate(a, b, (stamp_ns - stamp_a) / (stamp_b - stamp_a))


def interpolate(a: RigidTransform, b: RigidTransform, share: float) -> RigidTransform:
    """Between two poses: the position on a line, the rotation on the shorter arc.

    Normalised linear interpolation of quaternions: between samples milliseconds apart it differs
    from the constant turn by the angle's third power.
    """
    qa, qb = a.quaternion_xyzw(), b.quaternion_xyzw()
    if np.dot(qa, qb) < 0.0:
        qb = -qb
    return RigidTransform.from_quaternion_xyzw(
        (1.0 - share) * qa + share * qb,
        (1.0 - share) * a.translation_mm + share * b.translation_mm,
    )
