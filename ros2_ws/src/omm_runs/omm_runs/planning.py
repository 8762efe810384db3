"""A plan from files: part, camera, machine, and where the part is or a run that says so."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from omm_core.errors import InputError, MeasurementError
from omm_core.files.machine import MachineUncertainty, load_machine
from omm_core.files.part import Part, load_part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import load_calibration
from omm_core.machine.kinematics import Kinematics
from omm_core.part_pose import SolveOptions
from omm_core.part_pose.machine_noise import MachineNoise, noise_grid, summarise
from omm_core.planning.plan import Plan, make_plan
from omm_core.planning.scene import AssumedNoise, Scene
from omm_core.planning.wish import PlanWish
from omm_runs.solving import SolveRunOptions, solve_run


@dataclass(frozen=True, kw_only=True)
class PlanRequest:
    """What is to be planned; where the part is: ``part_at_mm``, ``near``, or the part's nominal."""

    part_file: Path
    calibration_file: Path
    machine_file: Path
    part_at_mm: tuple[float, float, float] | None = None
    part_turned_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near: Path | None = None
    wish: PlanWish = field(default_factory=PlanWish)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Place:
    machine_T_part: RigidTransform
    gamma_s_rad: float = 0.0
    machine: MachineUncertainty = field(default_factory=MachineUncertainty)
    image_sigma_px: float | None = None


def plan_of(request: PlanRequest) -> Plan:
    """Return the plan.

    Raises
    ------
    InputError
        Where a file cannot be used, or nothing says where the part is.
    MeasurementError
        Where no target can be seen, or the run that was named has no result.
    """
    part, calibration = load_part(request.part_file), load_calibration(request.calibration_file)
    machine = load_machine(request.machine_file)
    kinematics = Kinematics.load(request.machine_file)
    place = _place(request, part)
    noise, told = _noise(machine.uncertainty, place, part)
    scene = Scene(
        part=part,
        calibration=calibration,
        kinematics=kinematics,
        machine_T_part=place.machine_T_part,
        noise=noise,
        gamma_s_rad=place.gamma_s_rad,
    )
    return make_plan(scene, machine, request.wish, told=told)


def _place(request: PlanRequest, part: Part) -> _Place:
    if request.part_at_mm is not None and request.near is not None:
        raise InputError("Expected --part-at or --near, got both.")
    if request.part_at_mm is not None:
        alpha, beta, gamma = request.part_turned_rad
        return _Place(
            machine_T_part=RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, request.part_at_mm)
        )
    if request.near is not None:
        return _near(request, request.near)
    nominal = part.nominal
    if nominal is None or not nominal.complete():
        lacks = "holds no 'nominal'" if nominal is None else "leaves some of 'nominal' open (null)"
        raise InputError(
            f"{request.part_file} {lacks}: say roughly where the part is with --part-at X Y Z"
            " [--part-turned A B G] or --near RUN."
        )
    x, y, z = (float(v or 0.0) for v in nominal.translation_mm)
    alpha, beta, gamma = (float(v or 0.0) for v in nominal.euler_xyz_rad)
    return _Place(machine_T_part=RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, (x, y, z)))


def _near(request: PlanRequest, run: Path) -> _Place:
    """Return where a run found the part, and how exact it found machine and images to be."""
    solved = solve_run(
        run,
        SolveRunOptions(
            part_file=request.part_file,
            calibration_file=request.calibration_file,
            machine_file=request.machine_file,
        ),
    )
    solution = solved.result.solution
    if not solution.determined or solution.machine is None:
        raise MeasurementError(
            f"The run {run} does not say where the part is: {' '.join(solved.result.missing)}"
        )
    alpha, beta, gamma, *place_mm, gamma_s = solution.theta.tolist()
    variance = [np.trace(o.covariance_px2) / 2 for o in solution.observations]
    return _Place(
        machine_T_part=RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, place_mm),
        gamma_s_rad=gamma_s,
        machine=_medians(solution.machine),
        image_sigma_px=solution.machine.image_scale * float(np.sqrt(np.median(variance))),
    )


def _medians(noise: MachineNoise) -> MachineUncertainty:
    return MachineUncertainty(
        stop_sigma_mm=noise.stop_sigma_mm.median,
        geometry_sigma_mm=noise.geometry_sigma_mm.median,
        geometry_length_mm=noise.geometry_length_mm.median,
    )


def _prior(part: Part) -> MachineUncertainty:
    """Return the medians of the estimator's prior, for stops as far apart as the targets."""
    xyz = np.array([target.xyz_mm for target in part.targets])
    extent = max(float(np.linalg.norm(np.ptp(xyz, axis=0))), 1.0)
    grid = noise_grid(SolveOptions(), extent, scale_image=False)
    return _medians(summarise(grid, np.exp(grid.log_prior)))


def _noise(
    declared: MachineUncertainty, place: _Place, part: Part
) -> tuple[AssumedNoise, tuple[str, ...]]:
    """Return what is declared, else what the run showed, else the prior's median; and say which."""
    prior, seen = _prior(part), place.machine
    values, told = {}, []
    for name in ("stop_sigma_mm", "geometry_sigma_mm", "geometry_length_mm"):
        known = [getattr(source, name) for source in (declared, seen, prior)]
        first = next(i for i, value in enumerate(known) if value is not None)
        values[name] = float(known[first])
        matters = name != "geometry_length_mm" or values["geometry_sigma_mm"] > 0.0
        if first and matters:
            origin = "the run of --near shows" if first == 1 else "the median of the prior"
            told.append(f"machine.yaml does not tell {name}: {values[name]:.4g}, {origin}.")
    if told:
        told.append(
            "Of a machine that is not declared a measurement has to estimate how exact it is: its U"
            " is then 1.1 to 1.8 times as large as planned, mostly, and a bump is noticed as surely"
            " from 1.5 times the size on (docs/planning.md)."
        )
    image = {} if place.image_sigma_px is None else {"image_sigma_px": place.image_sigma_px}
    return AssumedNoise(**values, **image), tuple(told)
