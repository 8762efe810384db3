"""A LinuxCNC whose reader also tells the simulated truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from omm_cnc_bridge.control import (
    ControlSample,
    TruePose,
)
from omm_cnc_bridge.controls.linuxcnc.control import TRUTH_RATE_HZ, LinuxCncControl
from omm_core.geometry import RigidTransform
from omm_core.machine.kinematics import Kinematics


class SimulatedLinuxCnc(LinuxCncControl):
    """A LinuxCNC whose drives are simulated: from what it measures follows the truth for a camera.

    ``true_pose`` makes the true pose of a stamp and a reported one; without it, they are the same.
    """

    def __init__(
        self,
        machine: Kinematics,
        *,
        rate_hz: float,
        true_pose: Callable[[int, RigidTransform], RigidTransform] | None = None,
        **more: Any,
    ) -> None:
        self._every = max(1, math.ceil(TRUTH_RATE_HZ / rate_hz))
        super().__init__(rate_hz=rate_hz * self._every, **more)
        self._machine, self._true_pose = machine, true_pose
        self._count = 0
        self._truth: list[TruePose] = []

    def read(self, timeout_s: float) -> Sequence[ControlSample]:
        """Return the samples that the reader has sent, oldest first."""
        kept = []
        for sample in super().read(timeout_s):
            self._count += 1
            if sample.fault is None:
                pose = self._machine.machine_T_spindle(sample.positions)
                if self._true_pose is not None:
                    pose = self._true_pose(sample.stamp_ns, pose)
                self._truth.append(TruePose(stamp_ns=sample.stamp_ns, machine_T_spindle=pose))
            if self._count % self._every == 0:
                kept.append(sample)
        return kept

    def read_truth(self) -> Sequence[TruePose]:
        """Return where the spindle truly was since the last call."""
        truth, self._truth = self._truth, []
        return truth
