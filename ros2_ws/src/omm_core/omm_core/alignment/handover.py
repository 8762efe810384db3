"""A part's pose as a file for a control, and what that file cannot say.

The file's error is looked for at the corners of the part's box: the pose that the rounded words
say, against the pose itself.
"""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.alignment.control_lines import ControlLines
from omm_core.alignment.controls import CONTROLS, control_and_number
from omm_core.errors import InputError, MeasurementError
from omm_core.files.part import Part, load_part
from omm_core.geometry import RigidTransform
from omm_core.words import Words, keyed

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """A part's extent, part frame: ``low_mm``, ``high_mm`` (3,), and where they are from."""

    low_mm: Array
    high_mm: Array
    source: str

    def corners_mm(self) -> Array:
        """Return the corners, (8, 3)."""
        pairs = zip(self.low_mm, self.high_mm, strict=True)
        return np.array(list(itertools.product(*pairs)), dtype=float)

    def place_mm(self) -> Array:
        """Return the middle in x and y, z = 0: where is right what can be right at one place."""
        x, y, _ = (self.low_mm + self.high_mm) / 2.0
        return np.array([x, y, 0.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Handover:
    """A file for a control and its largest error at a corner of the part's box."""

    text: str
    error_mm: float
    words: ControlLines


DEFAULT_BOX = Box(
    low_mm=np.zeros(3),
    high_mm=np.full(3, 1000.0),
    source="assumed 0 to 1000 mm in each axis, no part file was given",
)


def box_of(part_file: Path) -> Box:
    """Return the box of a part file: ``box_mm``, else the box of its targets.

    Raises
    ------
    InputError
        Where the file cannot be used.
    """
    part = load_part(part_file)
    if part.box_mm is None:
        return box_of_targets(part)
    low, high = part.box_mm
    return Box(low_mm=low, high_mm=high, source="box_mm of the part file")


def box_of_targets(part: Part) -> Box:
    """Return the smallest box that holds all targets of a part."""
    points = np.array([target.xyz_mm for target in part.targets])
    return Box(low_mm=points.min(0), high_mm=points.max(0), source="the box of its targets")


def hand_over(
    pose: RigidTransform,
    control: str,
    *,
    offset: str | None = None,
    box: Box = DEFAULT_BOX,
    remaining_mm: float = 0.1,
    title: str = "pose as given",
) -> Handover:
    """Put ``machine_T_part`` into a control's own words.

    Raises
    ------
    InputError
        Where the control or offset does not exist, or ``remaining_mm`` is no length.
    MeasurementError
        Where the words miss a corner of the box by more than ``remaining_mm``.
    """
    if not (math.isfinite(remaining_mm) and remaining_mm >= 0.0):
        raise InputError(f"Expected what may remain as mm >= 0, got {remaining_mm}.")
    name = offset if offset is not None else CONTROLS[control].offset if control in CONTROLS else ""
    known, number = control_and_number(control, name)
    words = known.words(pose, box.place_mm(), name, number)
    misses = np.array([pose @ p - words.said @ p for p in box.corners_mm()])
    error_mm = float(np.linalg.norm(misses, axis=1).max())
    about_z = _tilt(pose) if control == "linuxcnc" else ()
    if error_mm > remaining_mm:
        raise MeasurementError(_refusal(pose, control, error_mm, remaining_mm))
    remarks = [
        f"omm: {_plain(title)}, for {control} {name}",
        _pose_line(pose),
        f"part's box: {_plain(box.source)}",
        *about_z,
        *(_heights(box, misses) if about_z else ()),
        f"largest error of these words at a corner of the box: {error_mm:.6f} mm"
        + (" (tilt and rounding)" if about_z else " (rounding)"),
        *(f"CONFIRM on this control: {line}" for line in words.unconfirmed),
    ]
    lines = [*(known.comment(remark) for remark in remarks), *words.lines]
    return Handover(text="\n".join(lines) + "\n", error_mm=error_mm, words=words)


def _refusal(pose: RigidTransform, control: str, error_mm: float, remaining_mm: float) -> Words:
    if control != "linuxcnc":
        return keyed(
            "said.rounding_refused",
            "{control} cannot express this pose: a corner of the part's box would be off by {mm}"
            " mm; {allowed} mm is allowed (what rounding leaves). Nothing is written. Align the"
            " part,"
            " or allow more with --remaining.",
            control=control, mm=f"{error_mm:.4f}", allowed=f"{remaining_mm:g}",
        )  # fmt: skip
    x, y = _tilts(pose)
    return keyed(
        "said.tilt_refused",
        "linuxcnc cannot express this pose: a corner of the part's box would be off by {mm} mm;"
        " {allowed} mm is allowed (tilt that remains: {x} about X, {y} about Y, in mm/m). Nothing"
        " is written. Align the part, or allow more with --remaining.",
        mm=f"{error_mm:.4f}", allowed=f"{remaining_mm:g}", x=x, y=y,
    )  # fmt: skip


def _tilt(pose: RigidTransform) -> tuple[str, ...]:
    x, y = _tilts(pose)
    return (f"tilt that remains: {x} about X, {y} about Y, in mm/m",)


def _tilts(pose: RigidTransform) -> tuple[str, str]:
    """Return the tilt about X and about Y, mm/m, as people read it."""
    return f"{-1e3 * pose.rotation[1, 2]:.6f}", f"{1e3 * pose.rotation[0, 2]:.6f}"


def _heights(box: Box, misses: Array) -> tuple[str, ...]:
    """Tell how far the real part stands above the control's idea, at the lower corners."""
    told = [
        f"{miss[2]:+.4f} at X{corner[0]:g} Y{corner[1]:g}"
        for corner, miss in zip(box.corners_mm(), misses, strict=True)
        if corner[2] == box.low_mm[2]
    ]
    return ("height of the part above these words, mm: " + ", ".join(told),)


def _pose_line(pose: RigidTransform) -> str:
    a, b, c = pose.euler_xyz_rad()
    x, y, z = pose.translation_mm
    return f"pose: alpha {a:.9f} beta {b:.9f} gamma {c:.9f} rad, x {x:.6f} y {y:.6f} z {z:.6f} mm"


def _plain(text: str) -> str:
    """Return words that can be nothing but a comment, whatever a file was called."""
    return re.sub(r"[^A-Za-z0-9 _.,-]", "_", text)
