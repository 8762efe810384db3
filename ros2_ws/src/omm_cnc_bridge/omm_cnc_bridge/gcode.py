"""A measuring program in G-code, with the handshake that the bridge answers.

Before anything else the spindle goes out along the tool, from wherever it is. What the program
changes of the modal state is restored at its end (M70, M72). The tool length is left alone: G53
does without it, and M72 would not give a G43.1 back.

For each stop: go there, wait, ask for image n (``M68 E0 Qn`` and ``M64 P0``), wait for the answer
(``M66 P0 L3``), withdraw the request, wait until the answer is withdrawn too. An image that does
not come stops the program with a message instead of leaving a hole in the measurement.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration

_FARTHEST_MM = 100_000.0
# What may be written into a program, and nothing else.
_RANGES = (
    ("distance_mm", 1.0, _FARTHEST_MM),
    ("stereo_base_mm", 0.1, _FARTHEST_MM),
    ("retract_mm", 0.0, _FARTHEST_MM),
    ("dwell_s", 0.0, 600.0),
    ("feed_mm_per_min", 1.0, 1_000_000.0),
    ("answer_timeout_s", 0.1, 3600.0),
)


@dataclass(frozen=True, kw_only=True)
class ProgramOptions:
    """How the targets are photographed."""

    distance_mm: float = 300.0
    """From the camera to the target, along the spindle's axis."""
    stereo_base_mm: float = 120.0
    """Between the two images of a target, along the spindle's x."""
    offset_mm: tuple[float, float] = (15.0, 35.0)
    """Where the targets lie off the spindle's axis on average, in the spindle's x and y."""
    retract_mm: float = 100.0
    """How far the camera backs off along the spindle's axis between targets."""
    dwell_s: float = 0.3
    feed_mm_per_min: float = 10000.0
    answer_timeout_s: float = 20.0

    def __post_init__(self) -> None:
        for name, lowest, highest in _RANGES:
            value = getattr(self, name)
            if not lowest <= value <= highest:  # false for NaN, too
                raise InputError(
                    f"Expected {name} between {lowest:g} and {highest:g} for a measuring program,"
                    f" got {value:g}."
                )
        if not all(abs(offset) <= _FARTHEST_MM for offset in self.offset_mm):
            raise InputError(
                f"Expected offset_mm within {_FARTHEST_MM:g} mm for a measuring program,"
                f" got {self.offset_mm}."
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Stop:
    """Where the spindle stops for an image of a target."""

    target_id: int
    spindle_in_machine_mm: NDArray[np.float64]


def stops_for(
    part: Part,
    calibration: CameraCalibration,
    machine_T_part: RigidTransform,
    machine_R_spindle: NDArray[np.float64],
    options: ProgramOptions,
) -> tuple[Stop, ...]:
    """Two stops for each target, one stereo base apart.

    Parameters
    ----------
    machine_T_part : RigidTransform
        Roughly where the part lies.
    machine_R_spindle : (3, 3) array
        How the spindle is turned at the stops.
    """
    depth_mm = float(calibration.taper_T_camera.translation_mm[2])
    stops = []
    for target in part.targets:
        for side in (-0.5, 0.5):
            target_in_spindle = np.array(
                [
                    options.offset_mm[0] - side * options.stereo_base_mm,
                    options.offset_mm[1],
                    depth_mm - options.distance_mm,
                ]
            )
            position = machine_T_part @ target.xyz_mm - machine_R_spindle @ target_in_spindle
            stops.append(Stop(target_id=target.id, spindle_in_machine_mm=position))
    return tuple(stops)


def measuring_program(
    stops: Sequence[Stop],
    machine_R_spindle: NDArray[np.float64],
    options: ProgramOptions,
    *,
    rotary_deg: Sequence[tuple[str, float]] = (),
    title: str = "measure",
) -> str:
    """The program for LinuxCNC, in machine coordinates (G53), mm.

    Raises
    ------
    InputError
        Where there is no stop.
    """
    if not stops:
        raise InputError("Expected stops for a measuring program, got none. Has the part targets?")
    for stop in stops:
        if not np.all(np.abs(stop.spindle_in_machine_mm) <= _FARTHEST_MM):
            raise InputError(
                f"Expected places within {_FARTHEST_MM:g} mm for a measuring program, got"
                f" {stop.spindle_in_machine_mm} for target {stop.target_id}."
            )
    away = options.retract_mm * machine_R_spindle[:, 2]
    lines = [
        f"({_comment(title)}: {len(stops)} images)",
        "M70 (M72 restores the modal state)",
        "G21 G90 G94 G40 G17",
        "G64 P0.001",
        *_retract(stops, away, machine_R_spindle[:, 2]),
    ]
    if rotary_deg:
        turned = " ".join(f"{name}{angle:.6f}" for name, angle in rotary_deg)
        lines.append(f"G53 G0 {turned}")
    lines += ["M65 P0", "M66 P0 L4 Q5 (no old answer)", f"F{options.feed_mm_per_min:.0f}"]
    lines.append(_beside(stops[0].spindle_in_machine_mm + away, machine_R_spindle[:, 2]))
    before: Stop | None = None
    for number, stop in enumerate(stops, start=1):
        if before is None or before.target_id != stop.target_id:
            if before is not None:
                lines.append(_move(before.spindle_in_machine_mm + away))
            lines.append(_move(stop.spindle_in_machine_mm + away))
        lines.append(_move(stop.spindle_in_machine_mm))
        lines += _ask(number, stop.target_id, options)
        before = stop
    lines.append(_move(stops[-1].spindle_in_machine_mm + away))
    lines += ["M72", "M2", "%"]
    return "%\n" + "\n".join(lines) + "\n"


def _comment(text: str) -> str:
    """Keep of a name what cannot end a comment or begin a block: a part's name is not ours."""
    return re.sub(r"[^A-Za-z0-9 ._-]", "_", text)[:60]


def _retract(
    stops: Sequence[Stop], away_mm: NDArray[np.float64], tool: NDArray[np.float64]
) -> list[str]:
    """Go to where all stops are cleared, along the tool only, from wherever the spindle is.

    The axis that is nearest to the tool's direction is moved. Where the spindle is farther out
    already it stays: nothing is known of what lies between.
    """
    axis = int(np.argmax(np.abs(tool)))
    outward = 1.0 if tool[axis] > 0.0 else -1.0
    places = [outward * (stop.spindle_in_machine_mm + away_mm)[axis] for stop in stops]
    clear = outward * max(places)
    letter = "XYZ"[axis]
    nearer = "LT" if outward > 0.0 else "GT"
    return [
        "(first out along the tool, then beside the first stop, then in)",
        f"O99 IF [#<_abs_{letter.lower()}> {nearer} {clear:.4f}]",
        f"G53 G0 {letter}{clear:.4f}",
        "O99 ENDIF",
    ]


def _beside(position_mm: NDArray[np.float64], tool: NDArray[np.float64]) -> str:
    """Move the two axes across the tool, as far out as the spindle is."""
    along = int(np.argmax(np.abs(tool)))
    words = [f"{'XYZ'[i]}{position_mm[i]:.4f}" for i in range(3) if i != along]
    return f"G53 G0 {' '.join(words)}"


def _move(position_mm: NDArray[np.float64]) -> str:
    x, y, z = position_mm
    return f"G53 G1 X{x:.4f} Y{y:.4f} Z{z:.4f}"


def _ask(number: int, target_id: int, options: ProgramOptions) -> list[str]:
    return [
        f"G4 P{options.dwell_s:g}",
        f"(image {number}: target {target_id})",
        f"M68 E0 Q{number}",
        "M64 P0",
        f"M66 P0 L3 Q{options.answer_timeout_s:g}",
        "M65 P0",
        f"O{100 + number} IF [#5399 LT 0]",
        f"(MSG,no image {number}: see /cnc/state for the reason)",
        "M72",
        "M2",
        f"O{100 + number} ENDIF",
        "M66 P0 L4 Q5",
    ]
