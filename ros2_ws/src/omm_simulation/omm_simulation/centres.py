"""What a camera would see at the stops of a cell's program, without making images.

The control runs its program, machine errors and all; centres are projected from where everything
truly is and get normal noise. Thousands of measurements take seconds, for Monte Carlo.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform, spindle_T_taper
from omm_core.imaging.circle import CircleCentre, project_circles
from omm_core.part_pose import Observation
from omm_simulation.cell import Cell
from omm_simulation.control import SimulatedControl

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Standing:
    """The spindle when an image is asked for.

    Attributes
    ----------
    target_id : int
        What the program is after.
    reported, true : RigidTransform
        machine_T_spindle as the control has it, and as it is.
    """

    stamp_ns: int
    target_id: int
    reported: RigidTransform
    true: RigidTransform


def stops_of(cell: Cell) -> Iterator[Standing]:
    """Run the cell's program; each image is acknowledged at once."""
    control, now_ns = SimulatedControl(cell), 0
    while (event_ns := control.next_event_ns()) is not None:
        state = control.state(now_ns)
        if not state.measure_requested:
            now_ns = max(now_ns, event_ns)
            control.state(now_ns)
            continue
        yield Standing(
            stamp_ns=now_ns,
            target_id=cell.stops[(state.measure_request - 1) % len(cell.stops)].target_id,
            reported=state.machine_T_spindle,
            true=control.true_machine_T_spindle(now_ns),
        )
        control.acknowledge(state.measure_request, now_ns)


def observed_centres(
    cell: Cell, sigma_px: float, random: np.random.Generator
) -> tuple[Observation, ...]:
    """Return the centre of each stop's target, with noise of a standard deviation (each axis)."""
    stops = tuple(stops_of(cell))
    centres = _project(cell, stops) + random.normal(0.0, 1.0, (len(stops), 2)) * sigma_px
    return tuple(
        Observation(
            stamp_ns=stop.stamp_ns,
            target_id=stop.target_id,
            center_px=centre,
            covariance_px2=np.eye(2) * sigma_px**2,
            machine_T_spindle=stop.reported,
        )
        for stop, centre in zip(stops, centres)
    )


def _project(cell: Cell, stops: tuple[Standing, ...]) -> Floats:
    calibration, part = cell.true_calibration, cell.true_part
    holder = spindle_T_taper(cell.gamma_s_rad) @ calibration.taper_T_camera
    targets = {t.id: t for t in part.targets}
    centres, normals, diameters = [], [], []
    for stop in stops:
        camera_T_part = (stop.true @ holder).inverse() @ cell.machine_T_part
        target = targets[stop.target_id]
        normal = part.normal_of(target)
        # Without a normal the dot faces the camera, as in the scene.
        centres.append(camera_T_part @ target.xyz_mm)
        normals.append(
            np.array([0.0, 0.0, 1.0]) if normal is None else camera_T_part.rotation @ normal
        )
        diameters.append(target.dot_diameter_mm)
    return np.asarray(
        project_circles(
            calibration.lens, np.array(centres), np.array(normals), diameters, CircleCentre.OUTLINE
        )
    )
