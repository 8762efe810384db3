"""Which spindle pose belongs to an image: only one that demonstrably stood still around it.

The judgement is a function of the image's stamp and of the *set* of pose samples by stamp. It does
not matter in which order they came, so that a run judged live and judged again from its recording
come out the same to the bit. Clocks that jump need no rule of their own: samples that then
interleave disagree with each other, and what disagrees did not stand still.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import compress, pairwise

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.geometry import RigidTransform, quaternion_xyzw_from_rotation
from omm_core.words import Words, keyed

_NUMBERS = 12  # rotation row by row, translation


@dataclass(frozen=True, kw_only=True)
class PairingOptions:
    """What standing still means.

    Attributes
    ----------
    window_ns : int
        So long before and after the stamp of an image the spindle must stand still.
    gap_ns : int
        Samples farther apart than this prove nothing about the time between them.
    tolerance_mm, tolerance_rad : float
        What samples of a spindle that stands still may differ by, noise included.
    """

    window_ns: int = 100_000_000
    gap_ns: int = 60_000_000
    tolerance_mm: float = 0.005
    tolerance_rad: float = 2e-5

    def __post_init__(self) -> None:
        for name in ("window_ns", "gap_ns", "tolerance_mm", "tolerance_rad"):
            if not getattr(self, name) > 0:
                raise InputError(f"Expected {name} above zero, got {getattr(self, name)}.")


@dataclass(frozen=True, kw_only=True, eq=False)
class PairedPose:
    """What became of one image's pose.

    Attributes
    ----------
    machine_T_spindle : RigidTransform or None
        Where the spindle stood; None where not known.
    reason : Words or None
        Why it is not known.
    pending : bool
        Whether samples that are still to come may change that.
    """

    machine_T_spindle: RigidTransform | None = None
    reason: Words | None = None
    pending: bool = False


class PoseTrack:
    """All pose samples of a clamping, by stamp."""

    def __init__(self, options: PairingOptions | None = None) -> None:
        self._options = options or PairingOptions()
        self._stamps: list[int] = []
        self._settled: dict[
            int, PairedPose
        ] = {}  # what samples that are still to come won't change
        self._rows: list[bytes] = []  # float64 numbers; two poses of one stamp: both, one after
        # the other in their order as bytes

    def __len__(self) -> int:
        """Return the number of different stamps."""
        return len(self._stamps)

    def add(self, stamp_ns: int, machine_T_spindle: RigidTransform) -> None:
        """Add a sample; in any order, and again where it came already."""
        numbers = [*machine_T_spindle.rotation.ravel(), *machine_T_spindle.translation_mm]
        row = np.array(numbers).tobytes()
        if not self._stamps or stamp_ns > self._stamps[-1]:
            self._stamps.append(stamp_ns)
            self._rows.append(row)
            return
        self._settled.clear()
        index = bisect_left(self._stamps, stamp_ns)
        if self._stamps[index] != stamp_ns:
            self._stamps.insert(index, stamp_ns)
            self._rows.insert(index, row)
        elif row not in _split(self._rows[index]):
            self._rows[index] = b"".join(sorted([*_split(self._rows[index]), row]))

    def forget(self, before_ns: int, around_ns: Iterable[int]) -> None:
        """Drop the samples before a time, but for those by which images are judged."""
        reach = self._options.window_ns + self._options.gap_ns
        kept = np.array(self._stamps) >= before_ns
        for stamp_ns in around_ns:
            first = bisect_left(self._stamps, stamp_ns - reach)
            kept[max(first - 1, 0) : bisect_right(self._stamps, stamp_ns + reach) + 1] = True
        self._stamps = list(compress(self._stamps, kept))
        self._rows = list(compress(self._rows, kept))
        self._settled.clear()

    def judge(self, stamp_ns: int) -> PairedPose:
        """Return the pose of the spindle at a stamp, or why it is not known."""
        judgement = self._settled.get(stamp_ns)
        if judgement is None:
            judgement = self._judge(stamp_ns)
            if not judgement.pending:
                self._settled[stamp_ns] = judgement
        return judgement

    def _judge(self, stamp_ns: int) -> PairedPose:
        options = self._options
        begin, end = stamp_ns - options.window_ns, stamp_ns + options.window_ns
        # From the last sample at or before the window to the first at or after it.
        first = max(bisect_right(self._stamps, begin) - 1, 0)
        last = min(bisect_left(self._stamps, end), len(self._stamps) - 1)
        stamps = self._stamps[first : last + 1]
        before, after = bisect_right(stamps, stamp_ns), len(stamps) - bisect_left(stamps, stamp_ns)
        pending = not self._stamps or self._stamps[-1] < end
        if after == 0:
            words = keyed("said.no_pose_after", "no spindle pose after the image")
            return PairedPose(reason=words, pending=pending)
        if before == 0:
            words = keyed("said.no_pose_before", "no spindle pose before the image")
            return PairedPose(reason=words, pending=pending)
        gaps = [b - a for a, b in pairwise(stamps)]
        uncovered = max(stamps[0] - begin, end - stamps[-1], 0)
        gap = max([*gaps, uncovered])
        if gap > options.gap_ns:
            words = keyed(
                "said.gap",
                "a gap of {s} s in the spindle poses around the image",
                s=f"{gap / 1e9:.3f}",
            )
            return PairedPose(reason=words, pending=pending)
        rows = [piece for row in self._rows[first : last + 1] for piece in _split(row)]
        samples = np.frombuffer(b"".join(rows)).reshape(-1, _NUMBERS)
        return _still(samples, options, pending)


def _split(row: bytes) -> list[bytes]:
    size = 8 * _NUMBERS
    return [row[i : i + size] for i in range(0, len(row), size)]


def _still(samples: NDArray[np.float64], options: PairingOptions, pending: bool) -> PairedPose:
    """Judge samples (S, 12) that cover the window."""
    position = samples[:, 9:]
    moved_mm = float(np.linalg.norm(np.ptp(position, axis=0)))
    # |R_1 - R_2| (Frobenius) = sqrt(2) times the angle, where that is small.
    turned_rad = float(np.linalg.norm(np.ptp(samples[:, :9], axis=0)) / math.sqrt(2.0))
    if moved_mm > options.tolerance_mm:
        words = keyed(
            "said.moved", "the spindle moved by {mm} mm around the image", mm=f"{moved_mm:.3f}"
        )
        return PairedPose(reason=words, pending=pending)
    if turned_rad > options.tolerance_rad:
        words = keyed(
            "said.turned",
            "the spindle turned by {angle} mm/m around the image",
            angle=f"{1e3 * turned_rad:.3f}",
        )
        return PairedPose(reason=words, pending=pending)
    mean = samples.mean(axis=0)
    # The mean of rotations that differ by 20 µrad is a rotation to 1e-10; the quaternion makes it
    # one to the last digit.
    pose = RigidTransform.from_quaternion_xyzw(
        quaternion_xyzw_from_rotation(mean[:9].reshape(3, 3)), mean[9:]
    )
    return PairedPose(machine_T_spindle=pose, pending=pending)
