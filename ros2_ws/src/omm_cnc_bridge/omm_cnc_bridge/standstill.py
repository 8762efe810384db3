"""Whether the spindle truly stands still.

A control's own word is not enough: "in position" usually follows the command, and a drive that lags
by 100 ms is still 0.4 mm off when it comes. In position is therefore: the control says so, *and*
every axis is close to its command, *and* no axis has moved for a dwell.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from omm_cnc_bridge.control import ControlSample
from omm_core.words import NOTHING, Words, keyed, verbatim


@dataclass(frozen=True, kw_only=True)
class StandStillLimits:
    """What counts as standing still."""

    tolerance_mm: float = 0.005
    """Largest departure of a linear axis from its command, and from where it came to rest."""
    tolerance_rad: float = 5e-6
    """The same for a rotary axis."""
    dwell_ns: int = 200_000_000
    """How long no axis may have moved."""
    gap_ns: int = 100_000_000
    """Samples further apart than this prove nothing about the time between them."""


class StandStill:
    """Judges the samples of one control, in the order of their stamps."""

    def __init__(self, limits: StandStillLimits, rotary: frozenset[str]) -> None:
        self._limits = limits
        self._rotary = rotary
        self._rest: Mapping[str, float] = {}
        self._since_ns = 0
        self._last_ns: int | None = None

    @property
    def since_ns(self) -> int:
        """Stamp of the first sample of the present rest."""
        return self._since_ns

    def update(self, sample: ControlSample) -> Words:
        """Return why the spindle is not known to stand still at this sample; empty when it is."""
        moved = self._moved(sample)
        if moved:
            self._rest = sample.positions
            self._since_ns = sample.stamp_ns
        self._last_ns = sample.stamp_ns
        if sample.fault:
            return verbatim(sample.fault)
        if sample.in_position is False:
            return keyed("said.not_in_position", "control: not in position")
        off = self._farthest(sample.positions, sample.commanded)
        if off is not None:
            return keyed("said.off_command", "{off} away from its command", off=off)
        if moved:
            return moved
        rested_ns = sample.stamp_ns - self._since_ns
        if rested_ns < self._limits.dwell_ns:
            return keyed(
                "said.dwell",
                "dwell: still for {s} of {wanted} s",
                s=f"{rested_ns / 1e9:.3f}",
                wanted=f"{self._limits.dwell_ns / 1e9:.3f}",
            )
        return NOTHING

    def forget(self) -> None:
        """Start anew, as after a lost connection."""
        self._last_ns = None

    def _moved(self, sample: ControlSample) -> Words:
        if self._last_ns is None:
            return keyed("said.first_sample", "first sample")
        gap_ns = sample.stamp_ns - self._last_ns
        if not 0 < gap_ns <= self._limits.gap_ns:
            return keyed(
                "said.gap_in_positions", "gap of {s} s in the positions", s=f"{gap_ns / 1e9:.3f}"
            )
        if self._rest.keys() != sample.positions.keys():
            return keyed("said.other_axes", "other axes than before")
        off = self._farthest(sample.positions, self._rest)
        if off is None:
            return NOTHING
        return keyed("said.off_place", "{off} from where it was", off=off)

    def _farthest(
        self, positions: Mapping[str, float], wanted: Mapping[str, float]
    ) -> Words | None:
        """Describe the first axis that is out of tolerance; NaN is out of it."""
        for axis, value in wanted.items():
            off = abs(positions.get(axis, math.nan) - value)
            if axis in self._rotary:
                if not off <= self._limits.tolerance_rad:
                    return keyed(
                        "said.axis_angle", "{axis} is {off} mrad", axis=axis, off=f"{off * 1e3:.4f}"
                    )
            elif not off <= self._limits.tolerance_mm:
                return keyed("said.axis_length", "{axis} is {off} mm", axis=axis, off=f"{off:.4f}")
        return None
