"""Leads the measuring program by what the estimator finds in its images.

The plan's file (`./omm plan --json`) says where each image is taken and of which targets. Before an
image is answered, what was found in it is waited for; a silent estimator costs the correction, not
the measurement: the program then goes on as planned.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.json_input import read_json
from omm_core.files.part import load_part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import load_calibration
from omm_core.machine.kinematics import Kinematics
from omm_core.planning.guide import Guide, StopCorrection
from omm_core.planning.plan_file import guide_from_plan

Found = Mapping[int, tuple[NDArray[np.float64], float]]
_KEPT = 50  # images whose finds are remembered


@dataclass(frozen=True, kw_only=True)
class GuidingFiles:
    """What a guide is made of."""

    plan_file: str
    part_file: str
    calibration_file: str


class Guiding:
    """Finds by image, and the guide that turns them into corrections. Safe for threads."""

    def __init__(self, guide: Guide, timeout_ns: int) -> None:
        self._guide, self._timeout_ns = guide, timeout_ns
        self._lock = threading.Lock()
        self._found: dict[int, Found] = {}
        self._running = False

    @classmethod
    def load(cls, files: GuidingFiles, machine: Kinematics, timeout_ns: int) -> Guiding:
        """Read plan, part and calibration. Raises InputError where they cannot be used."""
        if not (files.part_file and files.calibration_file):
            raise InputError("Expected part_file and calibration_file beside plan_file, got none.")
        plan = Path(files.plan_file)
        guide = guide_from_plan(
            read_json(plan, "plan"),
            str(plan),
            part=load_part(files.part_file),
            calibration=load_calibration(files.calibration_file),
            kinematics=machine,
        )
        return cls(guide, timeout_ns)

    def observed(self, stamp_ns: int, found: Found) -> None:
        """Take in what was found in an image."""
        with self._lock:
            self._found[stamp_ns] = found
            for old in sorted(self._found)[:-_KEPT]:
                del self._found[old]

    def heard(self, *, running: bool) -> None:
        """Take in whether the program runs: what the one before has seen is not believed."""
        if running and not self._running:
            with self._lock:
                self._guide.reset()
        self._running = running

    def is_ready(self, image_ns: int, now_ns: int) -> bool:
        """Return whether an image may be answered.

        Its finds are here, or were waited for long enough.
        """
        with self._lock:
            return image_ns in self._found or now_ns - image_ns > self._timeout_ns

    def correction(
        self, request: int, image_ns: int, machine_T_spindle: RigidTransform
    ) -> StopCorrection | None:
        """Return what the program is to be told; None where the estimator was silent."""
        with self._lock:
            found = self._found.get(image_ns)
            if found is None:
                return None
            return self._guide.after_image(request, machine_T_spindle, found)
