"""A touch probe in the simulated cell: it finds points of the part as that machine would.

The control shows where the machine's own scales say that the tip is: the true place minus the
geometry's error where the spindle stands, and off by the stop's own error. What the part really is
(warmer, its targets elsewhere) is touched, not what the part file says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from omm_core.errors import InputError
from omm_core.files.json_input import read_json
from omm_core.files.probed import ProbedPoint
from omm_core.geometry import RigidTransform
from omm_core.machine_errors import draw_stop_noise, thermally_expanded
from omm_simulation.cell import Cell, draw
from omm_simulation.scenario import load_scenario

PROBE_SIGMA_MM = 0.001
"""Of the probe's switching point, each axis."""
PROBE_LENGTH_MM = 200.0


def cell_of(truth_file: Path) -> Cell:
    """Return the cell that a simulated run was made in, drawn again from its truth.json.

    Raises
    ------
    InputError
        Where there is no such file, or it names no scenario.
    """
    truth = read_json(truth_file, "truth of a simulated run (truth.json beside it)")
    scenario, seed = truth.get("scenario"), truth.get("seed")
    if not isinstance(scenario, str) or isinstance(seed, bool) or not isinstance(seed, int):
        raise InputError(f"{truth_file}: expected scenario and seed of a simulated cell.")
    return draw(load_scenario(scenario), seed, bumped_id=truth.get("bumped_id"))


def touch(
    cell: Cell,
    points: Sequence[ProbedPoint],
    *,
    seed: int = 1,
    probe_sigma_mm: float = PROBE_SIGMA_MM,
) -> tuple[ProbedPoint, ...]:
    """Return the points with where the probe finds them, and with the probing's σ.

    σ counts the switching point and the stop's repeatability: what a metrologist would find by
    touching one point again and again.
    """
    random = np.random.default_rng([cell.seed, seed, 7])
    declared = cell.scenario.errors
    real = thermally_expanded(
        np.array([point.part_mm for point in points]),
        cell.errors.part_warmth_K,
        declared.part_expansion_per_K,
    )
    true = cell.machine_T_part @ real
    down = RigidTransform.from_euler_xyz_rad(*cell.scenario.machine.spindle_euler_xyz_rad)
    spindle = true - down @ np.array([0.0, 0.0, -PROBE_LENGTH_MM])
    shown = (
        true
        - cell.errors.geometry_mm(spindle)
        + draw_stop_noise(random, len(points), declared.stop_sigma_mm)
        + random.normal(0.0, probe_sigma_mm, (len(points), 3))
    )
    sigma = float(np.hypot(probe_sigma_mm, declared.stop_sigma_mm))
    return tuple(
        replace(point, machine_mm=place, sigma_mm=sigma) for point, place in zip(points, shown)
    )
