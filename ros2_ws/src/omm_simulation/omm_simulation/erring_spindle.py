"""Where the spindle truly is, for a control that moves by itself (LinuxCNC with simulated drives).

The simulated control knows its moves; of any other only its positions are known, sample by sample:
a stop begins where they cease to change.
"""

from __future__ import annotations

import numpy as np

from omm_core.geometry import RigidTransform
from omm_core.machine_errors import draw_stop_noise, lost_motion, spindle_drift
from omm_simulation.cell import Cell, random_stream

_MOVES_MM = 0.05


class ErringSpindle:
    """A cell's machine errors, added to what a control reports.

    Parameters
    ----------
    cell : Cell
    """

    def __init__(self, cell: Cell) -> None:
        self._errors, self._declared = cell.errors, cell.scenario.errors
        self._rng = random_stream(cell.clamping_seed, "machine")
        self._signs, self._of_stop = np.zeros(3), np.zeros(3)
        self._last_mm: np.ndarray | None = None
        self._begin_ns = 0

    def true_pose(self, stamp_ns: int, reported: RigidTransform) -> RigidTransform:
        """Return the true machine_T_spindle of a sample; samples come in the order of time."""
        position_mm = reported.translation_mm
        if self._last_mm is None:
            self._last_mm, self._begin_ns = position_mm, stamp_ns
        moved = np.abs(position_mm - self._last_mm) > _MOVES_MM
        if moved.any():
            self._signs = np.where(moved, np.sign(position_mm - self._last_mm), self._signs)
            self._last_mm = np.where(moved, position_mm, self._last_mm)
            self._of_stop = self._next_stop(stamp_ns)
        off_mm = self._errors.geometry_mm(position_mm) + self._of_stop
        return RigidTransform(rotation=reported.rotation, translation_mm=position_mm + off_mm)

    def _next_stop(self, stamp_ns: int) -> np.ndarray:
        declared = self._declared
        noise = draw_stop_noise(self._rng, 1, declared.stop_sigma_mm)[0]
        drift = spindle_drift(
            (stamp_ns - self._begin_ns) * 1e-9, declared.spindle_drift_mm, declared.spindle_drift_s
        )
        return np.asarray(noise + lost_motion(self._signs, declared.lost_motion_mm) + drift)
