"""Compare a plan's predicted covariance and its wish with measurements made by it.

    ./omm exec python bench/planning.py [RUNS]

One line a plan: images, seconds, the mean normalised squared error of so many measurements on
machines that err as machine.yaml declares (7 where the prediction is true; its spread over RUNS in
brackets), and the share of errors inside the predicted U (95.45 %).
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

from omm_core.planning.plan import make_plan  # noqa: E402
from omm_core.planning.wish import Wish  # noqa: E402

MANY = tuple((x, y) for x in (0.0, 750.0, 1500.0) for y in (0.0, 500.0, 1000.0))
SMALL = tuple((40.0 * (i % 4), 40.0 * (i // 4)) for i in range(8))
PLANS = {
    "4 targets, stops 3, geometry 15": (scene(REAL), Wish()),
    "4 targets, image 0.05 px only": (scene(EXACT, part=part(sigma_mm=0.0)), Wish()),
    "4 targets, U 0.04 wanted": (scene(REAL), Wish(point_mm=0.04)),
    "9 targets, turned": (
        scene(REAL, part=part(MANY), turned=(0.02, -0.03, 0.6), at=(900.0, 200.0, -100.0)),
        Wish(),
    ),
    "8 targets in one view": (scene(REAL, part=part(SMALL, 0.005), at=(300, 300, 0)), Wish()),
}


def main() -> int:
    """Print the table; 1 where a mean is off by more than four times its spread."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    wrong = 0
    print(f"{'plan':34} images  time  mean normalised squared error  inside U, worst parameter")
    for name, (cell, wish) in PLANS.items():
        plan = make_plan(cell, MACHINE, wish)
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
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
