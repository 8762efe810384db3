"""Where the simulated spindle truly was: what the simulated cameras take their images from."""

import threading
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

from omm_camera_driver.driver import FrameLost
from omm_core.geometry import RigidTransform

PoseAt = Callable[[int], RigidTransform]
"""machine_T_spindle at a time in ns."""

_LONGEST_GAP_NS = 100_000_000
_KEPT = 2000


class TruePoses:
    """Poses as they come in, asked for at any time in between; safe between threads."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, RigidTransform]] = deque(maxlen=_KEPT)
        self._news = threading.Condition()
        self.machine_T_part: RigidTransform | None = None
        """Where somebody has moved the part to; None where it stands as it was drawn."""

    def move_part(self, machine_T_part: RigidTransform) -> None:
        """Take in where the part is moved to (its jacks were turned)."""
        self.machine_T_part = machine_T_part

    def add(self, stamp_ns: int, machine_T_spindle: RigidTransform) -> None:
        """Take in a pose; one that is not later than the last one starts a new history."""
        with self._news:
            if self._poses and stamp_ns <= self._poses[-1][0]:
                self._poses.clear()
            self._poses.append((stamp_ns, machine_T_spindle))
            self._news.notify_all()

    def during(self, begin_ns: int, end_ns: int, timeout_s: float) -> PoseAt:
        """Return the poses at any time of an exposure, waiting for those still to come.

        Raises
        ------
        FrameLost
            There are none: no poses come, or there is a gap in that time.
        """
        with self._news:
            self._news.wait_for(
                lambda: self._poses and self._poses[-1][0] >= end_ns, timeout=timeout_s
            )
            poses = list(self._poses)
        if not poses:
            raise FrameLost(
                "Expected true poses of the spindle on /simulation/true_spindle_pose, got none. "
                "Is the bridge to a simulated control running?"
            )
        first = bisect_right(poses, begin_ns, key=_stamp) - 1
        last = bisect_left(poses, end_ns, key=_stamp)
        if first < 0 or last == len(poses):
            raise FrameLost(
                "Expected true poses of the spindle before and after the exposure, got them from "
                f"{(poses[0][0] - begin_ns) / 1e6:+.0f} to {(poses[-1][0] - begin_ns) / 1e6:+.0f} "
                "ms around its begin. Is the simulated control still running?"
            )
        needed = poses[first : last + 1]
        gap_ns = max((b[0] - a[0] for a, b in pairwise(needed)), default=0)
        if gap_ns > _LONGEST_GAP_NS:
            raise FrameLost(
                "Expected true poses of the spindle during the exposure at least every "
                f"{_LONGEST_GAP_NS // 1_000_000} ms, got a gap of {gap_ns / 1e6:.0f} ms."
            )
        return partial(_pose_at, needed)


def _pose_at(poses: list[tuple[int, RigidTransform]], stamp_ns: int) -> RigidTransform:
    after = min(max(1, bisect_left(poses, stamp_ns, key=_stamp)), len(poses) - 1)
    if len(poses) == 1:
        return poses[0][1]
    (stamp_a, a), (stamp_b, b) = poses[after - 1], poses[after]
    return interpolate(a, b, (stamp_ns - stamp_a) / (stamp_b - stamp_a))


def _stamp(pose: tuple[int, RigidTransform]) -> int:
    return pose[0]


def interpolate(a: RigidTransform, b: RigidTransform, share: float) -> RigidTransform:
    """Interpolate between two poses: the position on a line, the rotation on the shorter arc.

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
