"""The paper's pattern of stops: each target from two places, one stereo base apart.

What the simulated cells are measured with; a plan for a wanted uncertainty is made by
:mod:`omm_core.planning.plan`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.planning.program import ProgramStop

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Stop:
    """Where the program stops for an image of a target.

    Attributes
    ----------
    target_id : int
    spindle_in_machine_mm : ndarray, shape (3,)
        Programmed positions of X, Y, Z.
    """

    target_id: int
    spindle_in_machine_mm: Array


def paired_stops(
    part: Part,
    calibration: CameraCalibration,
    machine_T_part: RigidTransform,
    machine_R_spindle: Array,
    *,
    distance_mm: float,
    stereo_base_mm: float,
    offset_mm: tuple[float, float],
) -> Iterator[Stop]:
    """Yield two stops for each target, one stereo base apart along the spindle's x.

    Parameters
    ----------
    machine_T_part : RigidTransform
        Roughly where the part lies.
    machine_R_spindle : (3, 3) array
        How the spindle is turned at the stops.
    distance_mm : float
        From the camera to the target, along the spindle's axis.
    offset_mm : tuple
        Where the targets lie off the spindle's axis on average, in the spindle's x and y.
    """
    depth_mm = float(calibration.taper_T_camera.translation_mm[2])
    for target in part.targets:
        for side in (-0.5, 0.5):
            target_in_spindle = np.array(
                [offset_mm[0] - side * stereo_base_mm, offset_mm[1], depth_mm - distance_mm]
            )
            position = machine_T_part @ target.xyz_mm - machine_R_spindle @ target_in_spindle
            yield Stop(target_id=target.id, spindle_in_machine_mm=np.asarray(position))


def backing_off(stops: Sequence[Stop], away_mm: Array) -> list[ProgramStop]:
    """Return a program's stops on X, Y, Z: between targets the spindle backs off by ``away_mm``."""
    gone_to: list[ProgramStop] = []
    before: Stop | None = None
    for stop in stops:
        other = before is None or before.target_id != stop.target_id
        gone_to.append(
            ProgramStop(
                axes=_axes(stop.spindle_in_machine_mm),
                label=f"target {stop.target_id}",
                leave=(_axes(before.spindle_in_machine_mm + away_mm),) if other and before else (),
                arrive=(_axes(stop.spindle_in_machine_mm + away_mm),) if other else (),
            )
        )
        before = stop
    return gone_to


def _axes(position_mm: Array) -> dict[str, float]:
    return dict(zip("XYZ", position_mm.tolist()))
