"""Clampings of the camera, simulated and solved: what a campaign on a real machine would give.

``centres``: what the detector would find, with noise, at where the machine truly was; thousands of
clampings are affordable. ``images``: rendered, searched and solved as the nodes would do it.
Warming up of the spindle takes the time of a real program and is not in ``centres``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.campaign import THETA, Measured
from omm_core.errors import InputError, MeasurementError
from omm_core.geometry import RigidTransform
from omm_core.machine_errors import approach_signs, draw_stop_noise, lost_motion
from omm_core.part_pose import Observation, Solution, SolveOptions, build_problem, solve
from omm_core.part_pose.adjustment import Adjustment, predictions
from omm_simulation.cell import Cell, draw
from omm_simulation.scenario import Scenario, load_scenario

Floats = NDArray[np.float64]


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


def measure_clampings(settings: ClampingSettings, clampings: Sequence[int]) -> list[Measured]:
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


def observations_of(
    cell: Cell, random: np.random.Generator, noise_px: float
) -> tuple[Observation, ...]:
    """Return the centres that the detector would find in a measurement of a cell.

    The machine stops where its errors take it, anew each time; it reports where it was told to go.
    """
    told = np.array([stop.spindle_in_machine_mm for stop in cell.stops])
    declared = cell.scenario.errors
    signs = approach_signs(np.vstack([cell.scenario.machine.home_mm, told]))[1:]
    off = (
        cell.geometry_at_stops_mm()
        + draw_stop_noise(random, len(told), declared.stop_sigma_mm)
        + lost_motion(signs, declared.lost_motion_mm)
    )
    problem = build_problem(
        _observations(cell, told + off, noise_px), cell.true_part, cell.true_calibration
    )
    true = Adjustment(
        rotation=cell.machine_T_part.rotation.copy(),
        d0_mm=cell.machine_T_part @ problem.X0_mm,
        gamma_s_rad=cell.gamma_s_rad,
        cost=0.0,
        normal=np.zeros((7, 7)),
        converged=True,
        iterations=0,
    )
    pixels = predictions(problem, true)[0]
    return tuple(
        replace(seen, center_px=pixel + random.normal(0.0, noise_px, 2))
        for seen, pixel in zip(_observations(cell, told, noise_px), pixels)
    )


def _observations(cell: Cell, places: Floats, noise_px: float) -> list[Observation]:
    rotation = RigidTransform.from_euler_xyz_rad(
        *cell.scenario.machine.spindle_euler_xyz_rad
    ).rotation
    return [
        Observation(
            stamp_ns=number,
            target_id=stop.target_id,
            center_px=np.zeros(2),
            covariance_px2=np.eye(2) * noise_px**2,
            machine_T_spindle=RigidTransform(rotation=rotation, translation_mm=place),
        )
        for number, (stop, place) in enumerate(zip(cell.stops, places), start=1)
    ]


def _measured(
    scenario: Scenario, settings: ClampingSettings, clamping: int, repeat: int
) -> Measured:
    # Another clamping_seed turns the holder; a repeat of it draws everything else anew.
    cell = draw(scenario, settings.seed, clamping_seed=settings.seed + clamping)
    name = f"clamping {clamping}, repeat {repeat}"
    if settings.images:
        solution = _from_images(replace(cell, clamping_seed=_repeat_seed(settings, cell, repeat)))
    else:
        random = np.random.default_rng([settings.seed, clamping, repeat])
        seen = observations_of(cell, random, settings.noise_px)
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
    return Measured(
        clamping=clamping,
        repeat=repeat,
        theta=solution.theta,
        covariance=solution.covariance,
        theta_6d=theta_6d,
        truth=np.array([own[key] for key in THETA]),
        name=name,
    )


def _repeat_seed(settings: ClampingSettings, cell: Cell, repeat: int) -> int:
    """Return what draws stops and images of a repeat; the first is the clamping's own."""
    return cell.clamping_seed if repeat == 1 else cell.clamping_seed + 100_003 * (repeat - 1)


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
