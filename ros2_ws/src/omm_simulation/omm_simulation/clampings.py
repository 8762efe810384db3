"""Clampings of the camera, simulated and solved: what a campaign on a real machine would give.

``centres``: what the detector would find, with noise, at where the machine truly was; thousands of
clampings are affordable. ``images``: rendered, searched and solved as the nodes would do it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omm_core.budget.campaign import MeasuredRun
from omm_core.budget.campaign_file import THETA
from omm_core.errors import InputError, MeasurementError
from omm_core.part_pose import Solution, SolveOptions, solve
from omm_simulation.cell import Cell, draw
from omm_simulation.centres import observed_centres
from omm_simulation.scenario import Scenario, load_scenario


@dataclass(frozen=True, kw_only=True)
class ClampingSettings:
    """What is simulated.

    Attributes
    ----------
    scenario : str
        A name or a path.
    seed : int
        Draws machine, part and camera: the same for all clampings.
    repeats : int
        Measurements in each clamping.
    noise_px : float
        Of a centre; images bring their own.
    images : bool
        Render images instead of drawing centres.
    six : bool
        Solve with γ_s = 0, too (the paper's table 2).
    """

    scenario: str = "bench"
    seed: int = 1
    repeats: int = 1
    noise_px: float = 0.01
    images: bool = False
    six: bool = True

    def __post_init__(self) -> None:
        if self.repeats < 1 or not self.noise_px > 0.0:
            raise InputError(
                "Expected at least 1 repeat and noise above 0 px, got"
                f" {self.repeats} and {self.noise_px}."
            )


def measure_clampings(settings: ClampingSettings, clampings: Sequence[int]) -> list[MeasuredRun]:
    """Measure some clampings, by their numbers from 1; equal settings give equal results.

    Raises
    ------
    MeasurementError
        Where one cannot be solved.
    """
    scenario = load_scenario(settings.scenario)
    return [
        _measured(scenario, settings, clamping, repeat)
        for clamping in clampings
        for repeat in range(1, settings.repeats + 1)
    ]


def _measured(
    scenario: Scenario, settings: ClampingSettings, clamping: int, repeat: int
) -> MeasuredRun:
    cell = draw(scenario, settings.seed, clamping_seed=settings.seed + clamping, repeat=repeat)
    name = f"clamping {clamping}, repeat {repeat}"
    if settings.images:
        solution = _from_images(cell)
    else:
        random = np.random.default_rng([settings.seed, clamping, repeat])
        seen = observed_centres(cell, settings.noise_px, random)
        solution = solve(seen, scenario.part, scenario.calibration, SolveOptions())
    if not solution.determined or not solution.converged:
        reasons = "; ".join([*solution.missing, *solution.findings]) or "does not converge"
        raise MeasurementError(f"{name} (seed {settings.seed}) has no result: {reasons}.")
    theta_6d = None
    if settings.six:
        # Backlash makes 6D's residuals large: nothing is left out or refused for that here.
        options = SolveOptions(model="6d", find_errors=False)
        theta_6d = solve(solution.observations, scenario.part, scenario.calibration, options).theta
    own = cell.theta_own()
    return MeasuredRun(
        clamping=clamping,
        repeat=repeat,
        theta=solution.theta,
        covariance=solution.covariance,
        theta_6d=theta_6d,
        truth=np.array([own[key] for key in THETA]),
        name=name,
    )


def _from_images(cell: Cell) -> Solution:
    from omm_core.session.measurement import Measurement
    from omm_simulation.offline import PoseMessage, run

    measurement = Measurement(cell.scenario.part, cell.scenario.calibration)
    for message in run(cell):
        if isinstance(message, PoseMessage):
            measurement.add_pose(message.stamp_ns, message.machine_T_spindle)
        else:
            measurement.add_image(message.stamp_ns, message.image)
    return measurement.result().solution
