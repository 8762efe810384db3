"""Compare a plan's predicted covariance and its wish with measurements made by it.

    ./omm exec python bench/planning.py [RUNS [WORD]]

One line a plan: images, seconds, the mean normalised squared error of so many measurements on
machines that err as machine.yaml declares (7 where the prediction is true; its spread over RUNS in
brackets), and the share of errors inside the predicted U (95.45 %). Of the paper's bench and its
industrial use, U of x, y, z as predicted and as seen (the 95.45 % quantile of the errors), own
coordinates. With WORD: the plans whose name holds it.
"""

import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [
    str(Path(__file__).resolve().parents[1] / "ros2_ws/src/omm_core" / folder)
    for folder in ("", "test")
]

from planned_runs import own_error  # noqa: E402
from planning_cells import EXACT, MACHINE, REAL, part, scene  # noqa: E402

from omm_cnc_bridge.controls.simulated.control import machine_of  # noqa: E402
from omm_core.files.machine import AxisDynamics, Machine  # noqa: E402
from omm_core.geometry import RigidTransform  # noqa: E402
from omm_core.planning.plan import make_plan  # noqa: E402
from omm_core.planning.scene import AssumedNoise, Scene  # noqa: E402
from omm_core.planning.wish import PlanWish  # noqa: E402
from omm_simulation.scenario import load_scenario  # noqa: E402

MANY = tuple((x, y) for x in (0.0, 750.0, 1500.0) for y in (0.0, 500.0, 1000.0))
SMALL = tuple((40.0 * (i % 4), 40.0 * (i // 4)) for i in range(8))
PLANS = {
    "4 targets, stops 3, geometry 15": (scene(REAL), PlanWish()),
    "4 targets, image 0.05 px only": (scene(EXACT, part=part(sigma_mm=0.0)), PlanWish()),
    "4 targets, U 0.04 wanted": (scene(REAL), PlanWish(point_mm=0.04)),
    "9 targets, turned": (
        scene(REAL, part=part(MANY), turned=(0.02, -0.03, 0.6), at=(900.0, 200.0, -100.0)),
        PlanWish(),
    ),
    "8 targets in one view": (scene(REAL, part=part(SMALL, 0.005), at=(300, 300, 0)), PlanWish()),
}


WISHES = {
    "bench": PlanWish(place_mm=0.05, angle_mm_per_m=0.05),
    "bench, least time": PlanWish(place_mm=0.05, angle_mm_per_m=0.05, least_time=True),
    "industrial": PlanWish(place_mm=0.2, angle_mm_per_m=0.05, bump_mm=0.5),
    "industrial, least time": PlanWish(
        place_mm=0.2, angle_mm_per_m=0.05, bump_mm=0.5, least_time=True
    ),
}


def declared(name: str) -> tuple[Scene, Machine]:
    """Return a scenario's part, camera and machine; the machine declares its errors and pace."""
    scenario = load_scenario(name)
    errors, placement = scenario.errors, scenario.placement
    cell = Scene(
        part=scenario.part,
        calibration=scenario.calibration,
        kinematics=machine_of(scenario),
        machine_T_part=RigidTransform.from_euler_xyz_rad(
            *placement.euler_xyz_rad, placement.translation_mm
        ),
        noise=AssumedNoise(
            stop_sigma_mm=errors.stop_sigma_mm,
            geometry_sigma_mm=errors.geometry_sigma_mm,
            geometry_length_mm=errors.geometry_length_mm,
        ),
    )
    axes = {
        name: AxisDynamics(
            velocity=axis.velocity_mm_per_s,
            acceleration=axis.acceleration_mm_per_s2,
            jerk=axis.jerk_mm_per_s3,
        )
        for name, axis in scenario.machine.axes.items()
    }
    return cell, Machine(name=scenario.name, urdf=Path("none.urdf"), dynamics=axes)


def main() -> int:
    """Print the table; 1 where a mean is off by more than four times its spread."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    word = sys.argv[2] if len(sys.argv) > 2 else ""
    plans = {name: (cell, MACHINE, wish) for name, (cell, wish) in PLANS.items()}
    plans |= {name: (*declared(name.partition(",")[0]), wish) for name, wish in WISHES.items()}
    wrong = 0
    print(f"{'plan':34} images  time  mean normalised squared error  inside U, worst parameter")
    for name, (cell, machine, wish) in plans.items():
        if word not in name:
            continue
        plan = make_plan(cell, machine, wish)
        errors = np.array([own_error(plan, np.random.default_rng([7, i])) for i in range(runs)])
        scale = np.sqrt(np.diag(plan.covariance))
        correlation = plan.covariance / np.outer(scale, scale)
        white = np.linalg.solve(np.linalg.cholesky(correlation), (errors / scale).T)
        mean, spread = float(np.mean(np.sum(white**2, axis=0))), np.sqrt(14.0 / runs)
        inside = np.mean(np.abs(errors) < plan.expanded_uncertainty, axis=0)
        wrong += abs(mean - 7.0) > 4.0 * spread
        print(
            f"{name:34} {len(plan.stops):6d} {plan.seconds:4.0f} s"
            f"  {mean:12.2f} ({spread:.2f})            {inside.mean():.1%}, {inside.min():.1%}",
            flush=True,
        )
        if name in WISHES:
            _print_seen(plan.expanded_uncertainty, np.quantile(np.abs(errors), 0.9545, axis=0))
    return 1 if wrong else 0


def _print_seen(predicted: np.ndarray, seen: np.ndarray) -> None:
    for words, U in (("predicted", predicted), ("seen", seen)):
        places = ", ".join(f"{v:.4f}" for v in U[3:6])
        angles = ", ".join(f"{v:.4f}" for v in 1e3 * U[:3])
        print(f"    U {words:9}  x, y, z {places} mm;  α, β, γ {angles} mm/m", flush=True)


if __name__ == "__main__":
    sys.exit(main())
