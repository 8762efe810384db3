"""./omm repeatability: measure one part over many clampings, with 6D and with 7D."""

import argparse
import json
from pathlib import Path

_PAPER = {
    "paper 6D": (0.136, 0.056, 0.026, 0.039, 0.056, 0.070, None),
    "paper 7D": (0.032, 0.030, 0.020, 0.028, 0.024, 0.010, 3.840),
}
_COLUMNS = ("x mm", "y mm", "z mm", "α mm/m", "β mm/m", "γ mm/m", "γ_s mm/m")
_THETA_OF_COLUMN = (3, 4, 5, 0, 1, 2, 6)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--scenario", default="bench", help="(default %(default)s)")
    parser.add_argument("--clampings", type=int, default=10, metavar="N", help="(%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="(%(default)s)")
    parser.add_argument(
        "--fast", action="store_true", help="simulate centres with noise, without images"
    )
    parser.add_argument(
        "--noise-px", type=float, default=0.01, help="with --fast: of a centre (%(default)s)"
    )
    parser.add_argument("--json", metavar="OUT", type=Path, help="write all results as JSON")


def run(args: argparse.Namespace) -> int:
    """Print twice the standard deviations over all clampings, beside the paper's."""
    import numpy as np

    from omm_core.errors import InputError
    from omm_simulation.cell import draw
    from omm_simulation.scenario import load_scenario

    if args.clampings < 2 or not args.noise_px > 0.0:
        raise InputError(
            f"Expected at least 2 clampings and noise above 0 px, got {args.clampings} and"
            f" {args.noise_px}."
        )
    scenario = load_scenario(args.scenario)
    solved: dict[str, list] = {"6D": [], "7D": []}
    truth = []
    for clamping in range(args.clampings):
        cell = draw(scenario, args.seed, clamping_seed=args.seed + clamping)
        truth.append(list(cell.theta().values()))
        six, seven = _fast(cell, clamping, args) if args.fast else _with_images(cell)
        solved["6D"].append(six)
        solved["7D"].append(seven)
        if not args.fast:
            print(f"clamping {clamping + 1} of {args.clampings} measured", flush=True)
    errors = {name: np.array(thetas) - np.array(truth) for name, thetas in solved.items()}
    _print_table(errors, np.array(truth), args)
    if args.json:
        from omm_core.files.output import write_whole

        content = {"truth": truth, **{k: np.array(v).tolist() for k, v in solved.items()}}
        write_whole(args.json, json.dumps(content, indent=1) + "\n")
    return 0


def _with_images(cell):
    """Return θ of both models from rendered images, as the nodes would come to it."""
    from omm_core.session.measurement import Measurement
    from omm_simulation.offline import PoseMessage
    from omm_simulation.offline import run as run_cell

    measurement = Measurement(cell.scenario.part, cell.scenario.calibration)
    for message in run_cell(cell):
        if isinstance(message, PoseMessage):
            measurement.add_pose(message.stamp_ns, message.machine_T_spindle)
        else:
            measurement.add_image(message.stamp_ns, message.image)
    return _both(measurement.result().solution.observations, cell)


def _fast(cell, clamping: int, args: argparse.Namespace):  # type: ignore[no-untyped-def]
    """Return θ of both models from centres as the model predicts them, with noise."""
    from dataclasses import replace

    import numpy as np

    from omm_core.geometry import RigidTransform
    from omm_core.part_pose import Observation, build_problem
    from omm_core.part_pose.adjustment import Adjustment, predictions

    rotation = RigidTransform.from_euler_xyz_rad(
        *cell.scenario.machine.spindle_euler_xyz_rad
    ).rotation
    exact = [
        Observation(
            stamp_ns=number,
            target_id=stop.target_id,
            center_px=np.zeros(2),
            covariance_px2=np.eye(2) * args.noise_px**2,
            machine_T_spindle=RigidTransform(
                rotation=rotation, translation_mm=stop.spindle_in_machine_mm
            ),
        )
        for number, stop in enumerate(cell.stops, start=1)
    ]
    problem = build_problem(exact, cell.true_part, cell.scenario.calibration)
    true = Adjustment(
        rotation=cell.machine_T_part.rotation.copy(),
        d0_mm=cell.machine_T_part @ problem.X0_mm,
        gamma_s_rad=cell.gamma_s_rad,
        cost=0.0,
        normal=np.zeros((7, 7)),
        converged=True,
        iterations=0,
    )
    random = np.random.default_rng([args.seed, clamping])
    pixels = predictions(problem, true)[0]
    observations = [
        replace(o, center_px=pixel + random.normal(0.0, args.noise_px, 2))
        for o, pixel in zip(problem.observations, pixels)
    ]
    return _both(observations, cell)


def _both(observations, cell):
    """Return θ of 6D (γ_s taken as 0, as in the paper's table 2) and of 7D."""
    from omm_core.errors import MeasurementError
    from omm_core.part_pose import SolveOptions, solve

    thetas = []
    for model in ("6d", "7d"):
        # Backlash makes 6D's residuals large: nothing is left out or refused for that here.
        options = SolveOptions(model=model, find_errors=model == "7d")
        solution = solve(observations, cell.scenario.part, cell.scenario.calibration, options)
        if not solution.determined:
            raise MeasurementError("; ".join(solution.missing))
        thetas.append(solution.theta)
    return thetas


def _print_table(errors, truth, args: argparse.Namespace) -> None:  # type: ignore[no-untyped-def]
    import numpy as np

    how = f"centres with {args.noise_px} px noise" if args.fast else "rendered images"
    print(f"\nscenario {args.scenario}, {args.clampings} clampings, seed {args.seed}, {how}")
    print(
        "2 standard deviations over the clampings; γ_s: of what was measured (it differs from"
        " clamping to clamping), and of its error\n"
    )
    unit = np.array([1e3] * 3 + [1.0] * 3 + [1e3])
    rows = {f"omm {name}": 2.0 * error.std(axis=0, ddof=1) * unit for name, error in errors.items()}
    gamma_s_error = rows["omm 7D"][6]
    rows["omm 7D"][6] = 2e3 * (errors["7D"][:, 6] + truth[:, 6]).std(ddof=1)
    print(f"{'':9}" + "".join(f"{column:>10}" for column in _COLUMNS))
    for name, row in rows.items():
        values = [row[index] for index in _THETA_OF_COLUMN]
        _print_row(name, [*values[:6], None if name == "omm 6D" else values[6]])
    for name, published in _PAPER.items():
        _print_row(name, published)
    factors = [rows["omm 6D"][i] / rows["omm 7D"][i] for i in _THETA_OF_COLUMN[:6]]
    print(f"{'6D / 7D':9}" + "".join(f"{factor:10.1f}" for factor in factors))
    print(f"\n7D: 2 standard deviations of the error of γ_s: {gamma_s_error:.4f} mm/m")


def _print_row(name, values) -> None:  # type: ignore[no-untyped-def]
    print(f"{name:9}" + "".join(f"{'–':>10}" if v is None else f"{v:10.4f}" for v in values))
